"""The streams of one chunk of a coded file: codes of Gaussians to bytes and back, in two profiles."""

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int32, Int64

from splatproof.base.errors import DataError
from splatproof.methods.kernels import codec
from splatproof.methods.storage.packed.streams import expand, squeeze
from splatproof.reference.compression import columns, quantisers
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians

Profile = Literal["small", "fast"]
PARTS = ("positions", "opacity", "rotation", "scale", "dc", "rest")
"""Streams of a chunk, in their order in the file; each after its length in bytes (u32)."""
LEVEL = 19
"""zstd level of the fast profile: codes of harmonics take a quarter less than at 12, and decode as
fast."""
LOW = struct.Struct("<iB")
"""Lowest code of a column, and bits of what its codes are above that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Codes:
    """Codes of the Gaussians of a chunk, in the order of the file."""

    cells: Int32[np.ndarray, "n 3"]
    """Cell of each position, counted from the model's corner."""
    log_scales: Int32[np.ndarray, "n 3"]
    opacity: Int32[np.ndarray, "n 1"]
    rotation: Int32[np.ndarray, "n 3"]
    dc: Int32[np.ndarray, "n 3"]
    """Brightness and two differences of colour."""
    rest: Int32[np.ndarray, "d n"]
    """Harmonics: a row for each coefficient and in it each opponent channel."""


def quantise(model: Gaussians, steps: Steps, corner: Int64[np.ndarray, "3"]) -> Codes:
    """Codes of Gaussians.

    Args:
        model: The Gaussians, in the order of the file.
        steps: How finely they are stored.
        corner: Lowest cell of the model along each axis.

    Raises: DataError for numbers that are not finite or beyond their grid.

    Source: ours, see reference.compression.quantisers.
    """
    log_scales = quantisers.uniform("log scale", _numbers(model.log_scales), steps.log_scale)
    logits = _numbers(model.opacity_logits)
    if not np.isfinite(logits).all():
        raise DataError("opacity logit: not all finite: clean the model first")
    most = quantisers.MOST_LOGIT
    opacity = quantisers.uniform("opacity logit", logits.clip(-most, most), steps.opacity)
    sh = _numbers(model.sh)
    dc = quantisers.colour_difference(quantisers.uniform("SH DC", sh[:, 0], steps.dc))
    found = quantisers.classes(log_scales, opacity, steps.weights)
    rest = quantisers.harmonic_codes(sh[:, 1:], found, steps.harmonics)
    cells = quantisers.cells(_numbers(model.means), steps.position) - corner
    return Codes(
        cells=cells.astype(np.int32), log_scales=log_scales, opacity=opacity[:, None],
        rotation=quantisers.rotation_codes(_numbers(model.quaternions), steps.rotation_bits),
        dc=dc, rest=rest,
    )  # fmt: skip


def restore(codes: Codes, steps: Steps, corner: Int64[np.ndarray, "3"]) -> Gaussians:
    """Gaussians of codes, in float32.

    Args:
        codes: What quantise returned.
        steps: How finely they are stored.
        corner: Lowest cell of the model along each axis.

    Source: ours, see reference.compression.quantisers.
    """
    found = quantisers.classes(codes.log_scales, codes.opacity[:, 0], steps.weights)
    sh = np.empty((len(found), 1 + len(codes.rest) // 3, 3), dtype=np.float32)
    sh[:, 0] = quantisers.colour(codes.dc) * steps.dc
    sh[:, 1:] = codec.harmonics(codes.rest, found, steps.harmonics)
    return Gaussians(
        means=_tensor((codes.cells + corner) * steps.position),
        quaternions=_tensor(quantisers.rotations(codes.rotation, steps.rotation_bits)),
        log_scales=_tensor(codes.log_scales * steps.log_scale),
        opacity_logits=_tensor(codes.opacity[:, 0] * steps.opacity),
        sh=torch.from_numpy(sh),
    )


def write_streams(codes: Codes, steps: Steps, profile: Profile) -> list[bytes]:
    """The streams of a chunk, in the order of PARTS.

    Args:
        codes: Codes in the order of the Morton curve through their cells.
        steps: Its weights decide the classes, which are contexts.
        profile: small: contexts are mixed; fast: bytes of one kind lie together, through zstd.

    Raises: DataError where codes of one kind span more than 12 bits in the small profile.

    Source: ours.
    """
    order = codec.morton_of_cells(codes.cells)
    if profile == "fast":
        arrays = (codes.opacity, codes.rotation, codes.log_scales, codes.dc, codes.rest.T)
        first = squeeze(order[:, None], "zstd", planes=True, level=LEVEL)
        return [first, *(_plain(array) for array in arrays)]
    near = codec.nearest_before(codes.cells)
    found = quantisers.classes(codes.log_scales, codes.opacity[:, 0], steps.weights)
    nothing = np.zeros(len(near), dtype=np.int32)
    return [
        codec.encode_gaps(order),
        _columns("opacity logits", codes.opacity, near, _side(codes.log_scales)),
        _columns("rotations", codes.rotation, near, nothing),
        _columns("log scales", codes.log_scales, near, nothing),
        _columns("SH DC", codes.dc, near, nothing),
        codec.encode_harmonics(codes.rest, near, found),
    ]


def read_streams(
    streams: list[bytes], count: int, rest: int, steps: Steps, profile: Profile
) -> Codes:
    """The codes of a chunk's streams.

    Args:
        streams: What write_streams returned.
        count: Number of Gaussians.
        rest: Codes of harmonics of each.
        steps: Its weights decide the classes, which are contexts.
        profile: How the streams were written.

    Raises: DataError for streams that no writer wrote.

    Source: ours.
    """
    first, opacity, rotation, scale, dc, last = streams
    if profile == "fast":
        order = expand(first, count, 1, "<i8")[:, 0].copy()
        if count and (order[0] < 0 or (np.diff(order) < 0).any()):
            raise DataError("positions that are not in order")
        return Codes(
            cells=codec.cells_of_morton(order), opacity=_whole(opacity, count, 1),
            rotation=_within(_whole(rotation, count, 3), steps), log_scales=_whole(scale, count, 3),
            dc=_whole(dc, count, 3), rest=_whole(last, count, rest).T,
        )  # fmt: skip
    cells = codec.cells_of_morton(codec.decode_gaps(first, count))
    near, nothing = codec.nearest_before(cells), np.zeros(count, dtype=np.int32)
    log_scales = _codes(scale, 3, near, nothing)
    logits = _codes(opacity, 1, near, _side(log_scales))
    found = quantisers.classes(log_scales, logits[:, 0], steps.weights)
    return Codes(
        cells=cells, opacity=logits, rotation=_within(_codes(rotation, 3, near, nothing), steps),
        log_scales=log_scales, dc=_codes(dc, 3, near, nothing),
        rest=codec.decode_harmonics(last, rest, near, found),
    )  # fmt: skip


def _side(log_scales: Int32[np.ndarray, "n 3"]) -> Int32[np.ndarray, " n"]:
    """What a Gaussian's opacity is told of it: its middle scale, in two steps."""
    middle = np.sort(log_scales, axis=1)[:, 1]
    return ((middle + 4 * quantisers.MOST_CODE) >> 1).astype(np.int32)


def _columns(
    name: str,
    codes: Int32[np.ndarray, "n c"],
    near: Int32[np.ndarray, "n 3"],
    side: Int32[np.ndarray, " n"],
) -> bytes:
    """Lowest code and bits of each column, and the stream of what codes are above it."""
    low = codes.min(axis=0) if len(codes) else np.zeros(codes.shape[1], dtype=np.int32)
    above = np.ascontiguousarray((codes - low).T)
    bits = [int(column.max()).bit_length() if len(codes) else 0 for column in above]
    if max(bits) > columns.MOST_BITS:
        raise DataError(f"{name}: span more than {1 << columns.MOST_BITS} steps, which is what fits: "
                        "clean the model or take larger steps")  # fmt: skip
    head = b"".join(LOW.pack(int(a), b) for a, b in zip(low, bits, strict=True))
    return head + codec.encode_columns(above, np.array(bits, dtype=np.int32), near, side)


def _codes(
    data: bytes, width: int, near: Int32[np.ndarray, "n 3"], side: Int32[np.ndarray, " n"]
) -> Int32[np.ndarray, "n c"]:
    """The codes that _columns was given."""
    if len(data) < width * LOW.size:
        raise DataError("a stream that ends before its codes do")
    head = [LOW.unpack_from(data, LOW.size * c) for c in range(width)]
    low = np.array([a for a, _ in head], dtype=np.int32)
    bits = np.array([b for _, b in head], dtype=np.int32)
    if (np.abs(low.astype(np.int64)) > 2 * quantisers.MOST_CODE).any():
        raise DataError(f"codes from {low.tolist()} on: expected sizes up to 2^16")
    if bits.max() > columns.MOST_BITS:
        raise DataError(f"codes of {bits.tolist()} bits: expected up to {columns.MOST_BITS}")
    above = codec.decode_columns(data[width * LOW.size :], bits, near, side)
    return np.ascontiguousarray(above.T + low)


def _plain(codes: Int32[np.ndarray, "n c"]) -> bytes:
    """A byte that says of how many bytes a code is, and the stream."""
    size = 1 if not codes.size or np.abs(codes).max() < 128 else 4
    return bytes([size]) + squeeze(codes.astype(f"<i{size}"), "zstd", planes=True, level=LEVEL)


def _whole(data: bytes, count: int, width: int) -> Int32[np.ndarray, "n c"]:
    """The codes that _plain was given."""
    size = data[0] if data else 0
    if size not in (1, 4):
        raise DataError(f"codes of {size} bytes: expected 1 or 4")
    found = expand(data[1:], count, width, f"<i{size}").astype(np.int32)
    most = 4 * quantisers.MOST_CODE
    if size > 1 and found.size and (found.min() < -most or found.max() > most):
        raise DataError("codes beyond 2^17: expected less")
    return found


def _within(codes: Int32[np.ndarray, "n 3"], steps: Steps) -> Int32[np.ndarray, "n 3"]:
    """Codes of rotations, checked."""
    most = (1 << (steps.rotation_bits - 1)) - 1
    if codes.size and np.abs(codes).max() > most:
        raise DataError(f"codes of rotations beyond {most}")
    return codes


def _numbers(values: torch.Tensor) -> Float64[np.ndarray, "..."]:
    """A parameter in float64."""
    return values.detach().double().numpy()


def _tensor(values: np.ndarray) -> torch.Tensor:
    """A parameter in float32."""
    return torch.from_numpy(values.astype(np.float32))
