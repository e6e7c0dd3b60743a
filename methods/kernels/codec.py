"""Native twins of the coders in reference.compression: the same bytes, and the same refusals."""

from collections.abc import Callable
from functools import cache

import numpy as np
import torch
from jaxtyping import Float32, Int32, Int64

from splatproof import _ext
from splatproof.base.errors import DataError
from splatproof.reference.compression.gaps import WINDOW
from splatproof.reference.compression.logistic import squash, stretch
from splatproof.reference.compression.quantisers import OPPONENT


def morton_of_cells(cells: Int32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Twin of reference.compression.gaps.morton_of_cells.

    Args:
        cells: Cell numbers within [0, 2^21).
    """
    codes = np.empty(len(cells), dtype=np.int64)
    _ext.morton_of_cells(_tensor(cells), torch.from_numpy(codes))
    return codes


def cells_of_morton(codes: Int64[np.ndarray, " n"]) -> Int32[np.ndarray, "n 3"]:
    """Twin of reference.compression.gaps.cells_of_morton.

    Args:
        codes: Places on the curve.
    """
    cells = np.empty((len(codes), 3), dtype=np.int32)
    _ext.cells_of_morton(_tensor(codes), torch.from_numpy(cells))
    return cells


def nearest_before(
    cells: Int32[np.ndarray, "n 3"], window: int = WINDOW
) -> Int32[np.ndarray, "n 3"]:
    """Twin of reference.compression.gaps.nearest_before.

    Args:
        cells: Cell numbers within [0, 2^21).
        window: Number of Gaussians before one that are looked at, >= 1.
    """
    nearest = np.empty((len(cells), 3), dtype=np.int32)
    _ext.nearest_before(_tensor(cells), window, torch.from_numpy(nearest))
    return nearest


def encode_gaps(codes: Int64[np.ndarray, " n"]) -> bytes:
    """Twin of reference.compression.gaps.encode_gaps.

    Args:
        codes: Numbers within [0, 2^63) that never decrease.
    """
    return _ext.encode_gaps(_tables(), _tensor(codes))


def decode_gaps(data: bytes, count: int) -> Int64[np.ndarray, " n"]:
    """Twin of reference.compression.gaps.decode_gaps.

    Args:
        data: A stream.
        count: Number of codes.
    """
    codes = np.zeros(count, dtype=np.int64)
    return _decoded(codes, lambda out: _ext.decode_gaps(_tables(), data, out))


def encode_columns(
    codes: Int32[np.ndarray, "c n"],
    bits: Int32[np.ndarray, " c"],
    nearest: Int32[np.ndarray, "n 3"],
    side: Int32[np.ndarray, " n"],
) -> bytes:
    """Twin of reference.compression.columns.encode_columns.

    Args:
        codes: Codes of each column.
        bits: Bits of each column's codes, 0 to 12.
        nearest: Indices from nearest_before.
        side: A number of each Gaussian that the reader knows, >= 0.
    """
    around = _tensor(nearest), _tensor(side)
    return _ext.encode_columns(_tables(), _tensor(codes), _tensor(bits), *around)


def decode_columns(
    data: bytes,
    bits: Int32[np.ndarray, " c"],
    nearest: Int32[np.ndarray, "n 3"],
    side: Int32[np.ndarray, " n"],
) -> Int32[np.ndarray, "c n"]:
    """Twin of reference.compression.columns.decode_columns.

    Args:
        data: A stream.
        bits: Bits of each column's codes, 0 to 12.
        nearest: Indices from nearest_before.
        side: A number of each Gaussian that the reader knows, >= 0.
    """
    given = _tensor(bits), _tensor(nearest), _tensor(side)
    codes = np.zeros((len(bits), len(nearest)), dtype=np.int32)
    return _decoded(codes, lambda out: _ext.decode_columns(_tables(), data, *given, out))


def encode_harmonics(
    codes: Int32[np.ndarray, "d n"],
    nearest: Int32[np.ndarray, "n 3"],
    classes: Int32[np.ndarray, " n"],
) -> bytes:
    """Twin of reference.compression.harmonics.encode_harmonics.

    Args:
        codes: Codes of each column.
        nearest: Indices from nearest_before.
        classes: Class of each Gaussian's step, 0 to 6.
    """
    return _ext.encode_harmonics(_tables(), _tensor(codes), _tensor(nearest), _tensor(classes))


def decode_harmonics(
    data: bytes,
    columns: int,
    nearest: Int32[np.ndarray, "n 3"],
    classes: Int32[np.ndarray, " n"],
) -> Int32[np.ndarray, "d n"]:
    """Twin of reference.compression.harmonics.decode_harmonics.

    Args:
        data: A stream.
        columns: Their number, a multiple of 3.
        nearest: Indices from nearest_before.
        classes: Class of each Gaussian's step, 0 to 6.
    """
    given = _tensor(nearest), _tensor(classes)
    codes = np.zeros((columns, len(nearest)), dtype=np.int32)
    return _decoded(codes, lambda out: _ext.decode_harmonics(_tables(), data, *given, out))


def harmonics(
    codes: Int32[np.ndarray, "d n"], found: Int32[np.ndarray, " n"], base: float
) -> Float32[np.ndarray, "n k 3"]:
    """Twin of reference.compression.quantisers.harmonics.

    Args:
        codes: Codes of each column.
        found: Class of each Gaussian's step, 0 to 6.
        base: Step of class 3.
    """
    sh = np.empty((len(found), len(codes) // 3, 3), dtype=np.float32)
    opponent = torch.from_numpy(OPPONENT)
    _ext.restore_harmonics(_tensor(codes), _tensor(found), base, opponent, torch.from_numpy(sh))
    return sh


@cache
def _tables() -> _ext.CodecTables:
    """The tables of the logistic function, as the native code holds them."""
    return _ext.CodecTables(*(torch.from_numpy(table) for table in (stretch(), squash())))


def _tensor(array: np.ndarray) -> torch.Tensor:
    """The array without a copy, where it is contiguous."""
    return torch.from_numpy(np.ascontiguousarray(array))


def _decoded(codes: np.ndarray, work: Callable[[torch.Tensor], None]) -> np.ndarray:
    """What `work` writes into zeros. Raises: DataError for a stream that no encoder wrote."""
    try:
        work(torch.from_numpy(codes))
    except ValueError as error:
        raise DataError(f"a stream that {error}") from None
    return codes
