"""The header of a packed file, checked."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any

import torch

from splatproof.base.errors import DataError
from splatproof.base.memory import check_growth
from splatproof.base.numbers import finite
from splatproof.methods.contracts.reconstruction import Origin
from splatproof.methods.storage.packed.writer import FORMAT, PackedFacts

LARGEST_CHUNK = 2**20
KINDS: dict[str, type] = {
    "primitives": int, "bands": int, "chunk": int, "units": str, "method": str, "settings": dict,
    "mode": str, "shift": list, "packing": dict,
}  # fmt: skip
"""Types of the fields that every header has."""
ADDED: dict[str, tuple[type, ...]] = {
    "variant": (str,), "scene": (str,), "protocol": (dict,), "seed": (int, NoneType),
    "pose_noise": (str,), "depth_prior": (str,),
}  # fmt: skip
"""Types of the fields of Origin that the first files of version 2 lack."""


def read_header(path: Path, content: bytes, added: Mapping[str, type]) -> dict[str, Any]:
    """The header record, checked.

    Args:
        path: The file, for errors.
        content: The record.
        added: Types of fields beside those that every header has.
    Raises: DataError for anything but a header.
    """
    try:
        header = json.loads(content)
        if header["format"] != FORMAT:
            raise ValueError(f"format {header['format']!r}, expected {FORMAT!r}")
        for name, kind in (KINDS | dict(added)).items():
            if type(header[name]) is not kind:
                raise ValueError(f"{name} is {header[name]!r:.80}, expected {kind.__name__}")
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


def check_claims(path: Path, header: dict[str, Any], most_bytes: int) -> None:
    """Refuse headers that claim more than is allowed.

    Args:
        path: The file.
        header: Its header.
        most_bytes: Largest unpacked size that is allowed.
    Raises: DataError for such a header.
    """
    count, bands = header["primitives"], header["bands"]
    if 4 * count * (11 + 3 * bands) > most_bytes:
        raise DataError(f"{path}: claims {count} primitives; that is over {most_bytes} bytes")


def check_held(path: Path, header: dict[str, Any]) -> None:
    """Refuse headers of version 2 that claim more than the file can hold, before anything is allocated.

    Args:
        path: The file.
        header: Its header.
    Raises: DataError for such a header.
    """
    count, bands, size = header["primitives"], header["bands"], header["chunk"]
    stored = path.stat().st_size
    if -(-count // size) * 32 > stored:
        raise DataError(f"{path}: claims {count} primitives, more than it can hold")
    check_growth(path, 4 * count * (11 + 3 * bands), stored)


def facts_of(header: dict[str, Any]) -> PackedFacts:
    """What a file says beside its Gaussians; what its header lacks of their origin is unknown."""
    added = {name: header[name] for name in ADDED if name in header}
    return PackedFacts(
        mode=header["mode"], shift=torch.tensor(header["shift"], dtype=torch.float64),
        units=header["units"],
        origin=Origin(method=header["method"], settings=header["settings"], **added),
    )  # fmt: skip
