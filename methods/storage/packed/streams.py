"""One array of a packed chunk as bytes and back: differences, byte planes, zstd. Without loss."""

from typing import Literal

import numpy as np
import zstandard
from jaxtyping import Shaped

from splatproof.base.errors import DataError

LEVEL = 3
"""zstd level; 9 gains 1 % and takes four times as long (bytes whose order is already good)."""
DELTA, PLANES, ZSTD = 1, 2, 4
"""Bits of a stream's first byte: what was done to it, in this order."""
SAMPLE = 8192
"""Rows by which a stream decides whether differences pay."""
Entropy = Literal["none", "zstd"]


def squeeze(
    rows: Shaped[np.ndarray, "n c"], entropy: Entropy, *, planes: bool, level: int = LEVEL
) -> bytes:
    """Bytes of an array of n primitives: a byte that says how, then the stream.

    With planes, byte b of column c of all primitives lies together, and, where a sample gets
    smaller by it, numbers become differences of their bit patterns to the primitive before
    (wrapping, with the sign in the lowest bit): that pays when neighbours in the file are
    neighbours in space.

    Args:
        rows: Numbers of an unsigned or any little-endian type: only their bits count.
        entropy: "zstd" compresses the stream, "none" only rearranges it.
        planes: Whether bytes of one kind lie together; False keeps the array as it is, row after
            row.
        level: zstd's level, 1 to 22: smaller files for more seconds.

    Source: byte planes as in Blosc's shuffle filter; choice by sample: ours.
    """
    bits = np.ascontiguousarray(rows).view(f"<u{rows.dtype.itemsize}")
    how = (PLANES if planes else 0) | (ZSTD if entropy == "zstd" and rows.size else 0)
    if how == PLANES | ZSTD:
        sample = bits[:SAMPLE]
        if len(_stream(sample, how | DELTA, LEVEL)) < len(_stream(sample, how, LEVEL)):
            how |= DELTA
    return bytes([how]) + _stream(bits, how, level)


def expand(data: bytes, count: int, columns: int, kind: str) -> Shaped[np.ndarray, "n c"]:
    """The array that squeeze was given.

    Args:
        data: What squeeze returned.
        count: Number of rows n of the array.
        columns: Number of columns c.
        kind: Type of its numbers by numpy's name, as "<f2".

    Raises: DataError if the stream is not one of that shape.
    """
    size = np.dtype(kind).itemsize
    how, stream, expected = data[0] if data else 255, data[1:], count * columns * size
    if how > DELTA | PLANES | ZSTD:
        raise DataError(f"a stream of kind {how}: expected at most {DELTA | PLANES | ZSTD}")
    if how & ZSTD:
        try:
            if not expected or zstandard.frame_content_size(stream) != expected:
                raise DataError(f"a stream that does not unpack to {expected} bytes")
            stream = zstandard.ZstdDecompressor().decompress(
                stream, max_output_size=expected, allow_extra_data=False
            )
        except zstandard.ZstdError as error:
            raise DataError(f"a stream that does not unpack ({error})") from None
    if len(stream) != expected:
        raise DataError(f"a stream of {len(stream)} bytes, expected {expected}")
    flat = np.frombuffer(stream, dtype=np.uint8)
    if not how & PLANES:
        return flat.view(kind).reshape(count, columns)
    lanes = np.ascontiguousarray(flat.reshape(columns, size, count).transpose(0, 2, 1))
    bits = lanes.view(f"<u{size}")[:, :, 0]
    if how & DELTA:
        bits = np.add.accumulate((bits >> 1) ^ -(bits & 1), axis=1, dtype=bits.dtype)
    return bits.view(kind).T


def _stream(bits: Shaped[np.ndarray, "n c"], how: int, level: int) -> bytes:
    """The array after the steps that `how` names."""
    if not how & PLANES:
        return _packed(bits.tobytes(), how, level)
    lanes = np.ascontiguousarray(bits.T)
    if how & DELTA:
        size = 8 * bits.dtype.itemsize
        steps = np.diff(lanes, axis=1, prepend=lanes.dtype.type(0))
        lanes = (steps << 1) ^ -(steps >> (size - 1))
    columns, count = lanes.shape
    planes = lanes.view(np.uint8).reshape(columns, count, lanes.itemsize).transpose(0, 2, 1)
    return _packed(planes.tobytes(), how, level)


def _packed(raw: bytes, how: int, level: int) -> bytes:
    """Entropy-coded if `how` says so."""
    return zstandard.ZstdCompressor(level=level).compress(raw) if how & ZSTD else raw
