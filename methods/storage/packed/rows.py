"""Rows of a model by index, from memory or from a model folder that is too large for it."""

import json
import mmap
import os
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.methods.contracts.reconstruction import ARRAYS, describe
from splatproof.methods.models.explicit import FIELDS
from splatproof.reference.types.gaussians import Gaussians


@runtime_checkable
class Rows(Protocol):
    """Parameters of a model, gathered by index."""

    def __len__(self) -> int:
        """Return the number of primitives."""
        ...

    @property
    def bands(self) -> int:
        """SH coefficients of a channel."""
        ...

    def take(
        self, rows: Int64[Tensor, " m"] | slice, names: tuple[str, ...]
    ) -> Mapping[str, Tensor]:
        """Some parameters of some primitives.

        Args:
            rows: Indices of the primitives, in any order, or a slice.
            names: Names of the parameters, among FIELDS.

        Returns: Each parameter by its name, primitives in the order of `rows`.
        """
        ...


MAPPED = 2**30
"""Bytes of an array up to which rows in any order are read through the map. The system maps up to 2 MiB about
each, so that a chunk's rows have all of an array resident; those of larger ones are read one by one."""


class MemoryRows:
    """Rows of Gaussians in memory."""

    def __init__(self, model: Gaussians) -> None:
        """Hold the model."""
        self._model = model

    def __len__(self) -> int:
        """Return the number of primitives."""
        return len(self._model)

    @property
    def bands(self) -> int:
        """SH coefficients of a channel."""
        return self._model.sh.shape[1]

    def take(
        self, rows: Int64[Tensor, " m"] | slice, names: tuple[str, ...]
    ) -> Mapping[str, Tensor]:
        """Some parameters of some primitives, in the order of `rows`.

        Args:
            rows: Indices of the primitives, or a slice.
            names: Names of the parameters, among FIELDS.
        """
        return {name: getattr(self._model, name).detach()[rows] for name in names}


class FolderRows:
    """Rows of model.safetensors, mapped: pages that were read are given back after each call."""

    def __init__(self, folder: Path) -> None:
        """Map a model folder's arrays.

        Raises: DataError if they are not those that model.json describes, or not float32.
        """
        path = folder / ARRAYS
        if not path.exists() or sha256(path) != describe(folder).get("arrays_sha256"):
            raise DataError(f"{path}: its sha256 is not the one in model.json; copy it again")
        self._file = path.open("rb")
        weakref.finalize(self, self._file.close)
        self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        start = 8 + int.from_bytes(self._map[:8], "little")
        self._arrays: dict[str, np.ndarray] = {}
        self._starts: dict[str, int] = {}
        for name, entry in json.loads(self._map[8:start]).items():
            if name not in FIELDS:
                continue
            if entry["dtype"] != "F32":
                raise DataError(f"{path}: {name} is {entry['dtype']}, expected F32")
            low, high = entry["data_offsets"]
            self._starts[name] = start + low
            flat = np.frombuffer(self._map, "<f4", (high - low) // 4, start + low)
            self._arrays[name] = flat.reshape(entry["shape"])
        missing = [name for name in FIELDS if name not in self._arrays]
        if missing:
            raise DataError(f"{path}: no array {missing[0]!r}. Expected {', '.join(FIELDS)}")

    def __len__(self) -> int:
        """Return the number of primitives."""
        return len(self._arrays["means"])

    @property
    def bands(self) -> int:
        """SH coefficients of a channel."""
        return self._arrays["sh"].shape[1]

    def take(
        self, rows: Int64[Tensor, " m"] | slice, names: tuple[str, ...]
    ) -> Mapping[str, Tensor]:
        """Some parameters of some primitives, in the order of `rows`.

        Args:
            rows: Indices of the primitives, or a slice.
            names: Names of the parameters, among FIELDS.
        """
        found = {name: torch.from_numpy(self._taken(name, rows)) for name in names}
        self._map.madvise(mmap.MADV_DONTNEED)
        return found

    def _taken(self, name: str, rows: Int64[Tensor, " m"] | slice) -> np.ndarray:
        array = self._arrays[name]
        if isinstance(rows, slice):
            return array[rows].copy()
        if array.nbytes <= MAPPED:
            return array[rows.numpy()]
        size, start, file = array[0].nbytes, self._starts[name], self._file.fileno()
        data = b"".join([os.pread(file, size, start + size * row) for row in rows.tolist()])
        return np.frombuffer(bytearray(data), array.dtype).reshape(len(rows), *array.shape[1:])
