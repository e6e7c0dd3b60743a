"""Reading packed models: whole, or a chunk at a time, of any version."""

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, size_of
from splatproof.base.memory import GROWTH, SMALL, check_room
from splatproof.methods.contracts.reconstruction import (
    ARRAYS,
    DESCRIPTION,
    write_description,
)
from splatproof.methods.models.explicit import EXPLICIT, explicit_facts
from splatproof.methods.storage.float_file import write_float_stream
from splatproof.methods.storage.packed import coded_reader
from splatproof.methods.storage.packed.header import check_claims, check_held, facts_of, read_header
from splatproof.methods.storage.packed.records import (
    CODED,
    VERSION,
    chunk_records,
    records,
    split_streams,
    version_of,
)
from splatproof.methods.storage.packed.streams import expand
from splatproof.methods.storage.packed.writer import PARTS, PackedFacts, in_order
from splatproof.reference.compression import container, packing
from splatproof.reference.compression.affine_codes import STEPS
from splatproof.reference.types.gaussians import Gaussians

MOST_BYTES = 2**35
"""Largest unpacked model that read_packed opens (145 million primitives of degree 3)."""
KINDS = {"positions": (3, "<f4"), "opacity": (1, "<f2"), "rotation": (4, "<f2"),
         "scale": (3, "<f2"), "dc": (3, "<f2"), "kept": (1, "|u1"), "rest": (0, "|u1")}  # fmt: skip
"""Columns and type of each part; rest has 3 (bands - 1) columns."""


def read_packed(
    path: str | Path, *, threads: int | None = None, most_bytes: int = MOST_BYTES
) -> tuple[Gaussians, PackedFacts]:
    """The Gaussians of a packed file in float32, in the file's order, and what it says of them.

    Args:
        path: A file by write_coded, write_packed, or by reference.compression.container (version 1).
        threads: Number of threads that unpack; None: one for each core.
        most_bytes: Largest unpacked size; files that claim to have a larger one are refused.

    Raises: DataError, in one line, for anything but an intact file of a known version.
    """
    path = Path(path)
    facts, header, chunks = _opened(path, threads, most_bytes)
    if header is None:
        (model,) = chunks
        return model, facts
    check_room(path, 4 * header["primitives"] * (11 + 3 * header["bands"]))
    shapes = _shapes(header["primitives"], header["bands"])
    arrays = {name: torch.empty(shape) for name, shape in shapes.items()}
    start = 0
    for part in chunks:
        for name, values in vars(part).items():
            arrays[name][start : start + len(part)] = values
        start += len(part)
    return Gaussians(**arrays), facts


def unpack_packed(path: str | Path, folder: str | Path, *, threads: int | None = None) -> int:
    """Write a packed model as a model folder, a few chunks in memory at a time.

    Args:
        path: A file by write_coded, write_packed, or by reference.compression.container (version 1, which is in
            memory as a whole).
        folder: Where model.safetensors and model.json are written.
        threads: Number of threads that unpack; None: one for each core.

    Returns: Number of primitives.

    Raises: DataError as read_packed; nothing is written then.
    """
    path, folder = Path(path), Path(folder)
    facts, header, chunks = _opened(path, threads, 2**63)
    models = list(chunks) if header is None else []  # version 1 is one chunk
    count = header["primitives"] if header else len(models[0])
    bands = header["bands"] if header else models[0].sh.shape[1]
    (folder / DESCRIPTION).unlink(missing_ok=True)
    write_float_stream(
        folder / ARRAYS, _shapes(count, bands), (vars(model) for model in models or chunks)
    )
    told = explicit_facts(
        mode=facts.mode, shift=facts.shift, units=facts.units, primitives=count,
        degree=round(bands**0.5) - 1,
    )  # fmt: skip
    write_description(folder, EXPLICIT, facts.origin, told)
    return count


def _shapes(count: int, bands: int) -> dict[str, tuple[int, ...]]:
    """Shape of each parameter."""
    return {"means": (count, 3), "quaternions": (count, 4), "log_scales": (count, 3),
            "opacity_logits": (count,), "sh": (count, bands, 3)}  # fmt: skip


def _opened(
    path: Path, threads: int | None, most_bytes: int
) -> tuple[PackedFacts, dict[str, Any] | None, Iterator[Gaussians]]:
    """Facts, header (None for version 1) and chunks."""
    size_of(path)
    version = version_of(path)
    if version == 1:
        try:
            most = min(most_bytes, max(SMALL, GROWTH * path.stat().st_size))
            model = packing.unpack(container.decode(read_bytes(path), most_bytes=most))
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
        _check_finite(path, model)
        return PackedFacts(), None, iter([model])
    if version not in (VERSION, CODED):
        raise DataError(
            f"{path}: packed model of version {version}, this splatproof reads 1 to {CODED}; use the "
            "version that wrote it"
        )
    stream, workers = records(path), threads or os.cpu_count() or 1
    coded = version == CODED
    header = read_header(path, next(stream, b""), coded_reader.ADDED if coded else {})
    check_claims(path, header, most_bytes)
    if coded:
        coded_reader.check_chunks(path, header)
        decode = coded_reader.decoder(path, header)
    else:
        check_held(path, header)
        bands = header["bands"]
        decode = partial(_gaussians, bands, _table(path, next(stream, b""), 3 * (bands - 1)))
    return facts_of(header), header, _chunks(path, stream, header, decode, workers)


def _table(path: Path, content: bytes, dims: int) -> Float32[Tensor, "d 256"]:
    """Value of each code in each dimension: m + r / 255 code, rounded as the reference does."""
    ends = np.frombuffer(content[: len(content) // 4 * 4], dtype="<f4")
    if len(content) != 8 * dims or not np.isfinite(ends).all():
        raise DataError(f"{path}: lattice of {len(content)} bytes, expected {8 * dims}, all finite")
    low, reach = torch.from_numpy(ends.copy().reshape(2, dims)).double()
    return (low[:, None] + reach[:, None] / STEPS * torch.arange(256)).float()


def _chunks(
    path: Path,
    stream: Iterator[bytes],
    header: dict[str, Any],
    decode: Callable[[int, bytes], Gaussians],
    workers: int,
) -> Iterator[Gaussians]:
    """Gaussians of each chunk; refuses chunks that are missing or too many."""

    def part(item: tuple[int, bytes]) -> Gaussians:
        try:
            found = decode(*item)
        except DataError as error:
            raise DataError(f"{path}: a chunk that is none ({error})") from None
        _check_finite(path, found)
        return found

    numbered = chunk_records(path, stream, header["primitives"], header["chunk"])
    return in_order(part, numbered, workers)


def _check_finite(path: Path, part: Gaussians) -> None:
    """Refuse numbers that no packed model has: none is written with one, and seals can be forged."""
    for name, values in vars(part).items():
        if not values.sum().isfinite() and not values.isfinite().all():  # a sum takes half as long
            raise DataError(f"{path}: {name} that are not finite; pack the model again")


def _gaussians(
    bands: int, table: Float32[Tensor, "d 256"], count: int, content: bytes
) -> Gaussians:
    """The Gaussians of one chunk of version 2."""
    parts: list[str] = list(PARTS)
    streams = dict(zip(parts, split_streams(content, len(parts)), strict=True))

    def floats(name: str) -> Tensor:
        columns, kind = KINDS[name]
        values = expand(streams[name], count, columns, kind)
        return torch.from_numpy(values.astype(np.float32))

    bits = expand(streams["kept"], -(-count // 8), 1, "|u1")[:, 0]
    kept = np.flatnonzero(np.unpackbits(bits, count=count))
    codes = expand(streams["rest"], len(kept), len(table), "|u1").T
    sh = torch.zeros(count, bands, 3)
    sh[:, 0] = floats("dc")
    values = np.empty((len(kept), len(table)), dtype=np.float32)
    for dim, column in enumerate(table.numpy()):
        values[:, dim] = column[codes[dim]]
    if len(kept) == count:
        sh[:, 1:] = torch.from_numpy(values).reshape(count, bands - 1, 3)
    else:
        sh[torch.from_numpy(kept), 1:] = torch.from_numpy(values).reshape(len(kept), bands - 1, 3)
    return Gaussians(
        means=floats("positions"), quaternions=floats("rotation"), log_scales=floats("scale"),
        opacity_logits=floats("opacity")[:, 0], sh=sh,
    )  # fmt: skip
