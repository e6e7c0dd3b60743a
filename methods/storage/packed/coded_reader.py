"""Reading version 3 of the packed file: what its header adds, and its chunks."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.numbers import finite
from splatproof.methods.storage.packed.coded_chunk import PARTS, read_streams, restore
from splatproof.methods.storage.packed.records import number_of_records, split_streams
from splatproof.reference.compression.quantisers import MOST_CELL, Steps
from splatproof.reference.types.gaussians import Gaussians

ADDED: dict[str, type] = {"steps": dict, "corner": list}
"""Types of the header's fields beside those of version 2."""
MOST_CHUNK = 2**16
"""Gaussians of the largest chunk that a writer wrote."""
MOST_WEIGHT = 2**26
WEIGHTS = 6


def check_chunks(path: Path, header: dict[str, Any]) -> None:
    """Refuse a file that has not the chunks which its Gaussians need, before anything is allocated.

    How far a chunk may grow is not asked: equal Gaussians, as many as it may have, need some hundred bytes. Each is
    unpacked to what the header says or not at all.

    Args:
        path: The file.
        header: Its header, checked but for what version 3 adds.
    Raises: DataError for such a file.
    """
    count, size = header["primitives"], header["chunk"]
    if size > MOST_CHUNK:
        raise DataError(f"{path}: chunks of {size} primitives, expected up to {MOST_CHUNK}")
    needed, found = -(-count // size), number_of_records(path) - 1
    if found != needed:
        raise DataError(
            f"{path}: claims {count} primitives, which need {needed} chunks, and has {found}: the file was cut "
            "or joined, or made to fill the memory; get it again"
        )


def decoder(path: Path, header: dict[str, Any]) -> Callable[[int, bytes], Gaussians]:
    """What decodes a chunk, given its number of Gaussians and its content.

    Args:
        path: The file, for errors.
        header: Its header, checked but for what version 3 adds.
    Raises: DataError for a header that no writer wrote; the decoder for such a chunk.
    """
    try:
        steps, corner = _steps(header["steps"]), header["corner"]
        if len(corner) != 3 or any(type(c) is not int or abs(c) > MOST_CELL for c in corner):
            raise ValueError(f"corner is {corner!r:.80}, expected three cells")
        profile = header["packing"]["profile"]
        if profile not in ("small", "fast"):
            raise ValueError(f"profile is {profile!r:.80}, expected 'small' or 'fast'")
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: header of a packed model that is none ({error})") from None
    origin, rest = np.array(corner, dtype=np.int64), 3 * (header["bands"] - 1)

    def decode(count: int, content: bytes) -> Gaussians:
        streams = split_streams(content, len(PARTS))
        return restore(read_streams(streams, count, rest, steps, profile), steps, origin)

    return decode


def _steps(told: dict[str, Any]) -> Steps:
    """The steps of a header. Raises: KeyError, TypeError or ValueError for others."""
    names = {field.name for field in fields(Steps)}
    if set(told) != names:
        raise ValueError(f"steps of {sorted(told)!r:.80}, expected {sorted(names)}")
    known: dict[str, Any] = {}
    for name in ("position", "log_scale", "opacity", "dc", "harmonics"):
        known[name] = value = finite(told[name])
        if value is None or not 1e-12 <= value <= 1e12:
            raise ValueError(f"step {name} is {told[name]!r:.80}, expected 1e-12 to 1e12")
        known[name] = float(
            value
        )  # a whole number would make the codes times it whole, and overflow
    bits, weights = told["rotation_bits"], told["weights"]
    if type(bits) is not int or not 4 <= bits <= 12:
        raise ValueError(f"rotation_bits is {bits!r:.80}, expected 4 to 12")
    if len(weights) != WEIGHTS or any(type(k) is not int for k in weights):
        raise ValueError(f"weights are {weights!r:.80}, expected {WEIGHTS} whole numbers")
    if max(abs(k) for k in weights[1:]) > MOST_WEIGHT or abs(weights[0]) > 2**61:
        raise ValueError(f"weights are {weights!r:.80}, expected sizes up to {MOST_WEIGHT}")
    whole: dict[str, Any] = told | known | {"weights": tuple(weights)}
    return Steps(**whole)
