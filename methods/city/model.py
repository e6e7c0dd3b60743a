"""A reconstruction that knows the blocks it was made of."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, sha256, write_bytes
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.regions import AnyRegion, load_regions, save_regions
from splatproof.methods.contracts.reconstruction import ARRAYS, DESCRIPTION, Stored
from splatproof.methods.models.explicit import ExplicitModel, described, gaussians_in
from splatproof.methods.storage.deflated import deflated, inflated
from splatproof.methods.storage.packed.reader import read_packed

CITY = "city"
"""Kind of models that know their blocks."""
CONTAINER = "model.spgs"
"""The compressed Gaussians, where a model is compressed."""

REGIONS = "regions.safetensors"
"""Where the blocks of the partition lie."""

BLOCKS, DISTANCES = "deflated_blocks", "deflated_distances"
"""Arrays of files: the block of each Gaussian, and its distance in hundredths. Files from before have `blocks` and
`distances` as they are."""
NARROW = 256
"""Blocks whose numbers fit into a byte."""
STEPS = 100
"""Stored distances are whole numbers of hundredths, from 0 to FARTHEST of them."""
FARTHEST = 255
MEASURED = ("seconds", "cpu_seconds", "peak_mb", "refine_seconds", "refine_cpu_seconds")
"""Fields of BlockFacts that no two runs share."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CityModel(ExplicitModel):
    """Gaussians of all blocks together, and where each comes from."""

    blocks: Int64[Tensor, " n"]
    """Block that trained each Gaussian."""
    distances: Float[Tensor, " n"]
    """Normalised distance of each Gaussian to its own block: at most 1 in its core. Files hold it in hundredths."""
    block_facts: tuple[BlockFacts, ...]
    regions: tuple[AnyRegion, ...] = ()
    """Where each block of the partition lies: seams are looked for between them."""
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall seconds of each stage; a continued run's include those before."""
    stage_cpu_seconds: Mapping[str, float] = field(default_factory=dict)
    """Processor seconds of each stage, without those of blocks and parts that other processes trained; empty in
    files from before they were kept."""
    stage_peak_mb: Mapping[str, float] = field(default_factory=dict)
    """Peak memory of the largest process of each stage in 2^20 bytes, where it is known; empty in files from before it
    was kept."""
    refine_alone: Mapping[str, float] = field(default_factory=dict)
    """What a refinement in parts took without its parts, on one machine: wall "seconds" and "cpu_seconds". Empty where
    there are no parts, and in files from before it was kept."""
    packed: bytes | None = None
    """The compressed file that `model` was read from; None: not compressed."""
    packed_parts: Mapping[str, int] = field(default_factory=dict)
    """Bytes of each part of that file, see splatproof.methods.storage.packed; they sum to it."""

    @property
    def kind(self) -> str:
        """Name by which the loader of these models is found."""
        return CITY

    def store(self, folder: Path) -> Stored:
        """What `save_model` writes; regions and compressed Gaussians get files of their own.

        Args:
            folder: Where those files are written.
        """
        narrow = torch.uint8 if len(self.block_facts) <= NARROW else torch.int32
        mine = {
            BLOCKS: deflated(self.blocks.to(narrow).view(torch.uint8)),
            DISTANCES: deflated(in_hundredths(self.distances)),
        }
        arrays = mine if self.packed is not None else dict(super().store(folder).tensors) | mine
        path = folder / CONTAINER
        path.unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        save_regions(folder / REGIONS, self.regions)
        facts: dict[str, Any] = self.facts() | {
            "blocks": [
                asdict(facts) | {name: _in_places(getattr(facts, name)) for name in MEASURED}
                for facts in self.block_facts
            ],
            "stage_seconds": {n: _in_places(v) for n, v in self.stage_seconds.items()},
            "stage_cpu_seconds": {n: _in_places(v) for n, v in self.stage_cpu_seconds.items()},
            "stage_peak_mb": {n: _in_places(v) for n, v in self.stage_peak_mb.items()},
            "refine_alone": {n: _in_places(v) for n, v in self.refine_alone.items()},
        }
        if self.packed is not None:
            write_bytes(path, self.packed)
            facts["container"] = {
                "bytes": len(self.packed),
                "parts": dict(self.packed_parts),
                "sha256": sha256(path),
            }
        return Stored(tensors=arrays, facts=facts)


def load_city(folder: Path, stored: Stored, backend: str) -> CityModel:
    """The model of a folder whose model.json and arrays were read already.

    Args:
        folder: Folder of the model; its other files are read here.
        stored: Arrays and facts that the folder holds.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, for what is missing or damaged.
    """
    path, facts, arrays = folder / ARRAYS, stored.facts, dict(stored.tensors)
    packed = None
    if (container := facts.get("container")) is not None:
        path = folder / CONTAINER
        if not path.is_file() or sha256(path) != container["sha256"]:
            raise DataError(f"{path}: missing, or not the file of {DESCRIPTION}; copy it again")
        packed = read_bytes(path)
        arrays |= vars(read_packed(path)[0])
    model = gaussians_in(arrays, path)
    try:
        numbers, distances = _numbers(arrays, len(model), len(facts["blocks"]))
        if numbers.is_floating_point() or numbers.is_complex() or numbers.dtype == torch.bool:
            raise ValueError(f"blocks of type {numbers.dtype}, expected whole numbers")
        blocks = numbers.long()
        if len(blocks) and int(blocks.min()) < 0:
            raise ValueError(f"block {int(blocks.min())}, expected numbers from 0")
        if distances.dtype == torch.uint8:
            distances = distances / STEPS
        if not bool(distances.isfinite().all()):
            raise ValueError("a distance that is not finite")
        if blocks.shape != (len(model),) or distances.shape != (len(model),):
            raise ValueError(f"{len(blocks)} blocks and {len(distances)} distances for "
                             f"{len(model)} Gaussians")  # fmt: skip
        return CityModel(
            model=model, backend=backend, blocks=blocks, distances=distances, packed=packed,
            packed_parts=dict(container["parts"]) if container else {},
            block_facts=tuple(
                BlockFacts(**block | {n: float(block[n]) for n in MEASURED if n in block})
                for block in facts["blocks"]
            ),
            regions=load_regions(folder / REGIONS),
            stage_seconds={str(k): float(v) for k, v in facts["stage_seconds"].items()},
            stage_cpu_seconds={
                str(k): float(v) for k, v in facts.get("stage_cpu_seconds", {}).items()
            },
            stage_peak_mb={str(k): float(v) for k, v in facts.get("stage_peak_mb", {}).items()},
            refine_alone={str(k): float(v) for k, v in facts.get("refine_alone", {}).items()},
            **described(facts),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{folder / DESCRIPTION}: damaged ({error!r})") from None


def _numbers(arrays: Mapping[str, Tensor], count: int, blocks: int) -> tuple[Tensor, Tensor]:
    """Block and distance of each Gaussian as a file has them, unpacked.

    Raises: KeyError or ValueError for what is missing or damaged.
    """
    if BLOCKS not in arrays:
        return arrays["blocks"], arrays["distances"]
    narrow = torch.uint8 if blocks <= NARROW else torch.int32
    numbers = inflated(arrays[BLOCKS], count * narrow.itemsize).view(narrow)
    return numbers, inflated(arrays[DISTANCES], count)


def in_hundredths(distances: Float[Tensor, " n"]) -> UInt8[Tensor, " n"]:
    """Normalised distances as a byte each, rounded up, so that no bound of whole hundredths is crossed.

    What lies in the overlap band before does so after: its bounds are such (to a millionth, which is what float32
    makes of them). From 2.55 on all are 2.55; no rim is that wide.

    Args:
        distances: At least 0.
    """
    whole = (distances.double() * STEPS - 1e-4).ceil()
    return whole.clamp(0, FARTHEST).to(torch.uint8)


def _in_places(value: float) -> str:
    """A measured number in as many places as any other, so that a model's size does not tell of it."""
    return f"{value:.17e}"
