"""Reading packed models: whole, or a chunk at a time, of either version."""

import json
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, size_of
from splatproof.base.memory import GROWTH, SMALL, check_growth, check_room
from splatproof.base.numbers import finite
from splatproof.methods.contracts.reconstruction import (
    ARRAYS,
    DESCRIPTION,
    Origin,
    write_description,
)
from splatproof.methods.models.explicit import EXPLICIT, explicit_facts
from splatproof.methods.storage.float_file import write_float_stream
from splatproof.methods.storage.packed.records import VERSION, records, version_of
from splatproof.methods.storage.packed.streams import expand
from splatproof.methods.storage.packed.writer import FORMAT, PARTS, PackedFacts, in_order
from splatproof.reference.compression import container, packing
from splatproof.reference.compression.affine_codes import STEPS
from splatproof.reference.types.gaussians import Gaussians

MOST_BYTES = 2**35
"""Largest unpacked model that read_packed opens (145 million primitives of degree 3)."""
LARGEST_CHUNK = 2**20
KINDS = {"positions": (3, "<f4"), "opacity": (1, "<f2"), "rotation": (4, "<f2"),
         "scale": (3, "<f2"), "dc": (3, "<f2"), "kept": (1, "|u1"), "rest": (0, "|u1")}  # fmt: skip
"""Columns and type of each part; rest has 3 (bands - 1) columns."""

ADDED: dict[str, tuple[type, ...]] = {
    "variant": (str,), "scene": (str,), "protocol": (dict,), "seed": (int, NoneType),
    "pose_noise": (str,), "depth_prior": (str,),
}  # fmt: skip
"""Types of the fields of Origin that the first files of version 2 lack."""


def read_packed(
    path: str | Path, *, threads: int | None = None, most_bytes: int = MOST_BYTES
) -> tuple[Gaussians, PackedFacts]:
    """The Gaussians of a packed file in float32, in the file's order, and what it says of them.

    Args:
        path: A file by write_packed, or by reference.compression.container (version 1).
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
        path: A file by write_packed, or by reference.compression.container (version 1, which is in
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
    if version != VERSION:
        raise DataError(
            f"{path}: packed model of version {version}, this splatproof reads 1 and {VERSION}; use "
            "the version that wrote it"
        )
    stream = records(path)
    header = _header(path, next(stream, b""))
    count, bands, size = header["primitives"], header["bands"], header["chunk"]
    if -(-count // size) * 32 > path.stat().st_size:
        raise DataError(f"{path}: claims {count} primitives, more than it can hold")
    check_growth(path, 4 * count * (11 + 3 * bands), path.stat().st_size)
    if 4 * count * (11 + 3 * bands) > most_bytes:
        raise DataError(f"{path}: claims {count} primitives; that is over {most_bytes} bytes")
    table = _table(path, next(stream, b""), 3 * (bands - 1))
    facts = PackedFacts(
        mode=header["mode"], shift=torch.tensor(header["shift"], dtype=torch.float64),
        units=header["units"], origin=_origin(header),
    )  # fmt: skip
    return facts, header, _chunks(path, stream, header, table, threads or os.cpu_count() or 1)


def _header(path: Path, content: bytes) -> dict[str, Any]:
    """The header record, checked."""
    kinds = {"primitives": int, "bands": int, "chunk": int, "units": str, "method": str,
             "settings": dict, "mode": str, "shift": list, "packing": dict}  # fmt: skip
    try:
        header = json.loads(content)
        if header["format"] != FORMAT:
            raise ValueError(f"format {header['format']!r}, expected {FORMAT!r}")
        for name, kind in kinds.items():
            if type(header[name]) is not kind:
                raise ValueError(f"{name} is {header[name]!r}, expected {kind.__name__}")
        for name, types in ADDED.items():
            if name in header and type(header[name]) not in types:
                words = " or ".join(kind.__name__ for kind in types)
                raise ValueError(f"{name} is {header[name]!r}, expected {words}")
        shift = header["shift"]
        if len(shift) != 3 or any(finite(value) is None for value in shift):
            raise ValueError(f"shift is {shift!r:.80}, expected three finite numbers")
        if header["mode"] not in ("classic", "antialiased"):
            raise ValueError(f"mode is {header['mode']!r}, expected 'classic' or 'antialiased'")
        if header["bands"] not in (1, 4, 9, 16) or header["primitives"] < 0:
            raise ValueError(f"{header['primitives']} primitives of {header['bands']} SH bands")
        if not 1 <= header["chunk"] <= LARGEST_CHUNK:
            raise ValueError(f"chunks of {header['chunk']}, expected up to {LARGEST_CHUNK}")
        return header
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: header of a packed model that is none ({error})") from None


def _origin(header: dict[str, Any]) -> Origin:
    """Where a model comes from; what its file does not say is unknown."""
    added = {name: header[name] for name in ADDED if name in header}
    return Origin(method=header["method"], settings=header["settings"], **added)


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
    table: Float32[Tensor, "d 256"],
    workers: int,
) -> Iterator[Gaussians]:
    """Gaussians of each chunk; refuses chunks that are missing or too many."""
    count, size = header["primitives"], header["chunk"]
    starts = range(0, count, size)

    def numbered() -> Iterator[tuple[int, bytes]]:
        found = 0
        for found, content in enumerate(stream, start=1):
            if found > len(starts):
                break
            yield min(size, count - starts[found - 1]), content
        if found != len(starts):
            raise DataError(
                f"{path}: {found} chunks or more, expected {len(starts)}: the file was cut or joined"
            )

    def decode(item: tuple[int, bytes]) -> Gaussians:
        try:
            part = _gaussians(*item, header["bands"], table)
        except (DataError, struct.error) as error:
            raise DataError(f"{path}: a chunk that is none ({error})") from None
        _check_finite(path, part)
        return part

    return in_order(decode, numbered(), workers)


def _check_finite(path: Path, part: Gaussians) -> None:
    """Refuse numbers that no packed model has: none is written with one, and seals can be forged."""
    for name, values in vars(part).items():
        if not values.isfinite().all():
            raise DataError(f"{path}: {name} that are not finite; pack the model again")


def _gaussians(
    count: int, content: bytes, bands: int, table: Float32[Tensor, "d 256"]
) -> Gaussians:
    """The Gaussians of one chunk."""
    streams, at = {}, 0
    for name in PARTS:
        (length,) = struct.unpack_from("<I", content, at)
        streams[name] = content[at + 4 : at + 4 + length]
        at += 4 + length
    if at != len(content):
        raise DataError(f"{len(content)} bytes of streams, expected {at}")

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
