"""The file of a compressed model: header, checksum, arrays packed without loss. Bytes to bytes.

Layout, little-endian: 4 bytes magic, u16 version, u8 degree, u8 packing (0 none, 1 zstd), u64
primitives, u64 payload bytes, 32 bytes SHA-256 of the four fields before it and the payload; then
the payload. Unpacked it holds, one after the other, each array of `LAYOUT`, row-major.
"""

import hashlib
import struct
from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
import zstandard
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.compression.affine_codes import AffineCodes
from splatproof.reference.compression.packing import PackedModel

MAGIC = b"SPGS"
VERSION = 1
HEADER = struct.Struct("<4sHBBQQ32s")
LEVEL = 9
"""zstd level; fixed, so that equal models give equal files."""
MOST_BYTES = 2**33
"""Largest unpacked model that is opened unless the caller says otherwise (100 million primitives)."""
Packing = Literal["none", "zstd"]
PACKINGS: tuple[Packing, ...] = ("none", "zstd")
Shape = tuple[int, ...]
LAYOUT: tuple[tuple[str, type, Callable[[int, int], Shape]], ...] = (
    ("means", np.float32, lambda n, d: (n, 3)),
    ("opacity_logits", np.float16, lambda n, d: (n,)),
    ("quaternions", np.float16, lambda n, d: (n, 4)),
    ("log_scales", np.float16, lambda n, d: (n, 3)),
    ("dc", np.float16, lambda n, d: (n, 3)),
    ("low", np.float32, lambda n, d: (d,)),
    ("range", np.float32, lambda n, d: (d,)),
    ("codes", np.uint8, lambda n, d: (n, d)),
)
"""Name, type and shape of each array, for n primitives with d residual numbers each."""


def encode(model: PackedModel, packing: Packing = "zstd") -> bytes:
    """The bytes of a stored model. Equal models give equal bytes.

    Args:
        model: What packing.pack returned, or decode.
        packing: "none" is what the authors' code does: 79 bytes a primitive of degree 3.

    Source: StitchGS, Sec. 3.3.2 (mixed precision, standard lossless packing); layout: ours.
    """
    arrays = vars(model) | {
        "low": model.rest.low,
        "range": model.rest.range,
        "codes": model.rest.codes,
    }
    raw = b"".join(
        arrays[name].detach().numpy().astype(np.dtype(kind).newbyteorder("<")).tobytes()
        for name, kind, _ in LAYOUT
    )
    payload = raw if packing == "none" else zstandard.ZstdCompressor(level=LEVEL).compress(raw)
    degree = round((model.rest.codes.shape[1] / 3 + 1) ** 0.5) - 1
    fields = (MAGIC, VERSION, degree, PACKINGS.index(packing), len(model), len(payload))
    return HEADER.pack(*fields, _checksum(fields, payload)) + payload


def decode(data: bytes, *, most_bytes: int = MOST_BYTES) -> PackedModel:
    """The model in a file's bytes: exactly the arrays that encode was given.

    Sizes are compared with each other and with `most_bytes` before anything is allocated.

    Args:
        data: All bytes of one file.
        most_bytes: Largest unpacked size that is allowed, in bytes: the bound on memory.

    Raises: DataError for anything but an intact file of this version.
    """
    if len(data) < HEADER.size or data[:4] != MAGIC:
        raise DataError(f"not a compressed model: it starts with {data[:4]!r}, expected {MAGIC!r}")
    *fields, digest = HEADER.unpack_from(data)
    _, version, degree, packing, count, size = fields
    if version != VERSION:
        raise DataError(f"compressed model of version {version}: this program reads {VERSION}")
    payload = data[HEADER.size :]
    if len(payload) != size:
        raise DataError(f"compressed model with {len(payload)} bytes of content, expected {size}: "
                        "the file was cut or joined; copy it again")  # fmt: skip
    if _checksum(tuple(fields), payload) != digest:
        raise DataError("compressed model with a wrong checksum: it was altered; copy it again")
    if degree > 3 or packing >= len(PACKINGS):
        raise DataError(
            f"degree {degree}, packing {packing}: expected degree 0 to 3, packing 0 or 1"
        )
    shapes = [shape(count, 3 * ((degree + 1) ** 2 - 1)) for _, _, shape in LAYOUT]
    # Python's own numbers: a count of 2^60 does not wrap around
    sizes = [
        _product(s) * np.dtype(k).itemsize for s, (_, k, _) in zip(shapes, LAYOUT, strict=True)
    ]
    raw = _unpacked(payload, PACKINGS[packing], sum(sizes), most_bytes)
    arrays: dict[str, Tensor] = {}
    start = 0
    for (name, kind, _), shape, length in zip(LAYOUT, shapes, sizes, strict=True):
        part = np.frombuffer(raw[start : start + length], dtype=np.dtype(kind).newbyteorder("<"))
        arrays[name] = torch.from_numpy(part.astype(kind).reshape(shape))
        start += length
    rest = AffineCodes(codes=arrays.pop("codes"), low=arrays.pop("low"), range=arrays.pop("range"))
    return PackedModel(**arrays, rest=rest)


def _unpacked(payload: bytes, packing: Packing, expected: int, most_bytes: int) -> bytes:
    """The payload's arrays as one run of `expected` bytes.

    Raises: DataError if the header and the payload disagree, or for more than `most_bytes`.
    """
    if expected > most_bytes:
        raise DataError(f"compressed model that claims {expected} bytes: the limit is {most_bytes}; "
                        "raise it if you trust the file")  # fmt: skip
    try:
        frame = zstandard.frame_content_size(payload) if packing == "zstd" else len(payload)
        if frame != expected:
            raise DataError(f"compressed model with {frame} bytes of arrays, expected {expected}")
        if packing == "none":
            return payload
        return zstandard.ZstdDecompressor().decompress(
            payload, max_output_size=expected, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise DataError(f"compressed model that does not unpack ({error})") from error


def _checksum(fields: tuple[object, ...], payload: bytes) -> bytes:
    """SHA-256 of the header before the checksum, and of the payload."""
    return hashlib.sha256(HEADER.pack(*fields, b"")[:-32] + payload).digest()


def _product(shape: Shape) -> int:
    """Number of elements, without overflow."""
    result = 1
    for size in shape:
        result *= size
    return result
