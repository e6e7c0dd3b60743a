"""One trained block as stitching reads it: where it lies, and its Gaussians a slice at a time."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.reconstruction import ARRAYS, describe
from splatproof.methods.models.explicit import FIELDS
from splatproof.reference.partition.boxes import Region
from splatproof.reference.types.gaussians import Gaussians

CHUNK = 2**19
"""Primitives in memory at once where a model streams: 120 MB of degree 3."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockModel:
    """A region and the Gaussians trained for it, in memory or in a model folder."""

    region: Region
    """Where it lies before the margin of training."""
    model: Gaussians | Path
    """The Gaussians, or the folder that save_model wrote; that is read in slices."""

    def __len__(self) -> int:
        """Return the number of primitives."""
        if isinstance(self.model, Gaussians):
            return len(self.model)
        return int(describe(self.model)["primitives"])

    @property
    def bands(self) -> int:
        """SH coefficients of a channel: (degree + 1)^2."""
        if isinstance(self.model, Gaussians):
            return self.model.sh.shape[1]
        return (int(describe(self.model)["degree"]) + 1) ** 2

    def slices(self, names: tuple[str, ...] = FIELDS) -> Iterator[dict[str, Tensor]]:
        """The named parameters of up to CHUNK primitives at a time, in order.

        Args:
            names: Which of FIELDS are read.

        Raises: DataError if the folder's arrays are missing, damaged or fewer than it says.
        """
        count, chunk = len(self), CHUNK
        if isinstance(self.model, Gaussians):
            for start in range(0, count, chunk):
                yield {n: getattr(self.model, n)[start : start + chunk].detach() for n in names}
            return
        path = self.model / ARRAYS
        for start in range(0, count, chunk):
            try:
                with safe_open(
                    path, framework="pt"
                ) as file:  # reopened: a mapped file stays in memory
                    parts = {n: file.get_slice(n)[start : start + chunk].clone() for n in names}
            except (SafetensorError, OSError) as error:
                raise DataError(f"{path}: not a whole model ({error})") from None
            if any(len(part) != min(chunk, count - start) for part in parts.values()):
                raise DataError(f"{path}: fewer primitives than the {count} its model.json says")
            yield parts
