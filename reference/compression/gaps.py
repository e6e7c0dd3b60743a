"""Positions on a grid as places on the Morton curve, and those as gaps."""

import numpy as np
from jaxtyping import Int32, Int64

from splatproof.base.errors import DataError
from splatproof.reference.compression.mixing import Mixing
from splatproof.reference.compression.range_coder import Coder, RangeDecoder, RangeEncoder

AXIS_BITS = 21
"""Bits of a cell along one axis; the three of a code fill an int64 but for the sign."""
NEAREST = 3
"""Earlier Gaussians whose codes are contexts."""
WINDOW = 128
"""Gaussians before one among which its nearest are looked for."""


def morton_of_cells(cells: Int32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Place of each cell on the Morton curve: bit b of axis a is bit 3 b + a.

    Args:
        cells: Cell numbers within [0, 2^21).

    Source: Morton 1966, "A computer oriented geodetic data base".
    """
    codes = np.zeros(len(cells), dtype=np.int64)
    for bit in range(AXIS_BITS):
        for axis in range(3):
            codes |= (cells[:, axis].astype(np.int64) >> bit & 1) << (3 * bit + axis)
    return codes


def cells_of_morton(codes: Int64[np.ndarray, " n"]) -> Int32[np.ndarray, "n 3"]:
    """The cells whose places are given: the inverse of morton_of_cells.

    Source: Morton 1966, "A computer oriented geodetic data base".
    """
    cells = np.zeros((len(codes), 3), dtype=np.int32)
    for bit in range(AXIS_BITS):
        for axis in range(3):
            cells[:, axis] |= ((codes >> (3 * bit + axis) & 1) << bit).astype(np.int32)
    return cells


def nearest_before(
    cells: Int32[np.ndarray, "n 3"], window: int = WINDOW
) -> Int32[np.ndarray, "n 3"]:
    """The three nearest of the `window` Gaussians before each, nearest first; -1 where there are none.

    By squared distance in cells; of two that are equally far the later comes first. A reader of the
    positions finds the same, so what lies near is a context of all else.

    Args:
        cells: Cell numbers within [0, 2^21), in the order of the file.
        window: Number of Gaussians before one that are looked at, >= 1.

    Source: ours.
    """
    found = np.full((len(cells), NEAREST), -1, dtype=np.int32)
    wide = cells.astype(np.int64)
    for i in range(len(cells)):
        before = np.arange(i - 1, max(0, i - window) - 1, -1)
        away = ((wide[before] - wide[i]) ** 2).sum(axis=1)
        chosen = before[np.argsort(away, kind="stable")[:NEAREST]]
        found[i, : len(chosen)] = chosen
    return found


def encode_gaps(codes: Int64[np.ndarray, " n"]) -> bytes:
    """Codes that never decrease, as a stream.

    Of each difference to the code before, plus 1, the length in bits is coded with the lengths
    before it as contexts, then two bits below the leading one with the length, then the rest plain.

    Args:
        codes: Numbers within [0, 2^63), none smaller than the one before.

    Raises: DataError where they decrease.

    Source: ours.
    """
    if len(codes) and (codes[0] < 0 or (np.diff(codes) < 0).any()):
        raise DataError("codes decrease or are below 0: sort them first")
    coder = RangeEncoder()
    _gaps(coder, codes.tolist())
    return coder.finish()


def decode_gaps(data: bytes, count: int) -> Int64[np.ndarray, " n"]:
    """The codes of a stream.

    Args:
        data: What encode_gaps returned.
        count: Number of codes.

    Raises: DataError if it is not a stream of so many codes.

    Source: ours.
    """
    coder = RangeDecoder(data)
    codes = _gaps(coder, [0] * count)
    coder.finish()
    return np.array(codes, dtype=np.int64)


def _gaps(coder: Coder, codes: list[int]) -> list[int]:
    """The codes; a writer is told them, a reader finds them."""
    lengths, heads = Mixing(3, 64**3), Mixing(2, 1024)
    before, last, second = -1, 0, 0
    for i, code in enumerate(codes):
        gap = max(code - before + (i > 0), 1)
        contexts, node = (0, last << 6, (last << 6 | second) << 6), 1
        for bit in range(5, -1, -1):
            node = node << 1 | lengths.code(coder, contexts, node, gap.bit_length() - 1 >> bit & 1)
        length, value = node & 63, 1
        for place in range(length):
            y = gap >> (length - 1 - place) & 1
            if place < 2:
                head = (length << 2, length << 2 | 256)
                y = heads.code(coder, head, 1 if place == 0 else 2 + (value & 1), y)
            else:
                y = coder.bit(1 << 15, y)
            value = value << 1 | y
        before += value - (i > 0)
        if before >> 63:
            raise DataError("a stream that leaves the grid of positions")
        codes[i] = before
        last, second = length, last
    return codes
