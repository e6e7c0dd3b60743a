"""Where blocks lie: regions with one normalised distance, for stitching, merging and seam masks.

d(p) <= 1 in a block's core, up to 1.1 in the rim where blocks compete, above it outside. All
positions are in the scene's frame.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.voxel_region import INSIDE, VoxelRegion
from splatproof.methods.storage.deflated import deflated, inflated
from splatproof.reference.partition.boxes import Box, OrientedBox, Region, box_distance
from splatproof.reference.partition.contracted_grid import contract

KIND = "splatproof regions"
VERSION = 2
READ = (1, 2)
"""Versions that are read; in the first, voxels lay as they are, a byte each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedRegion:
    """An oriented box, d(p) = |diag(e)^-1 R (p - c)|_inf.

    Source: StitchGS, Sec. 3.2.3; bounds: ours.
    """

    box: OrientedBox
    bounds: OrientedBox | None = None
    """Box around all blocks: a place outside it counts as the nearest place in it, so that the
    outermost blocks reach to infinity and nothing beyond them is lost. None: they do not."""

    @property
    def centre(self) -> Float64[Tensor, "3"]:
        """Centre of the box."""
        return self.box.centre.double()

    def distance(self, points: Float64[Tensor, "n 3"]) -> Float64[Tensor, " n"]:
        """d(p) of each position."""
        if self.bounds is not None:
            turn = self.bounds.rotation.to(points)
            half = self.bounds.half.to(points) * (1 - INSIDE)
            local = (points - self.bounds.centre.to(points)) @ turn.T
            points = local.maximum(-half).minimum(half) @ turn + self.bounds.centre.to(points)
        return box_distance(self.box, points)


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundRegion:
    """A rectangle on the ground, infinitely high: d(p) = max over x, y of |(R p - c) / e|.

    For cells of the camera-balanced grid.

    Source: ours, after StitchGS, Sec. 3.2.3 (d_i) and VastGaussian, Sec. 4.1 (cells).
    """

    frame: Float64[Tensor, "3 3"]
    """R: its rows are x, y along the ground and up, orthonormal (ground_frame)."""
    corners: Float64[Tensor, "2 2"]
    """Lowest and highest x, y in that frame."""
    bounds: Float64[Tensor, "2 2"] | None = None
    """Lowest and highest x, y of all blocks together: a place beyond counts as the nearest within.
    None: it does not."""

    def __post_init__(self) -> None:
        """Refuse a rectangle without area."""
        if not bool((self.corners[1] > self.corners[0]).all() & self.corners.isfinite().all()):
            raise DataError(f"rectangle {self.corners.tolist()}: expected lower, then upper corner")

    @property
    def centre(self) -> Float64[Tensor, "3"]:
        """Centre of the rectangle, at height 0 of the frame."""
        return self.corners.mean(dim=0) @ self.frame[:2]

    def distance(self, points: Float64[Tensor, "n 3"]) -> Float64[Tensor, " n"]:
        """d(p) of each position."""
        local = points @ self.frame[:2].T
        if self.bounds is not None:
            hair = INSIDE * (self.bounds[1] - self.bounds[0])
            local = local.clamp(self.bounds[0] + hair, self.bounds[1] - hair)
        half = (self.corners[1] - self.corners[0]) / 2
        return ((local - self.corners.mean(dim=0)) / half).abs().amax(dim=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class ContractedRegion:
    """A cell of CityGaussian's grid: d(p) = max over axes of |(contract(R p) - c) / e|.

    Distances are taken in contracted space, where cells are boxes and the outermost ones reach to
    infinity.

    Source: CityGaussian, Sec. 3.2 (contraction, grid); d: ours, after StitchGS, Sec. 3.2.3.
    """

    frame: Float64[Tensor, "3 3"]
    """R: its rows are x, y along the ground and up, orthonormal (ground_frame)."""
    foreground: Float64[Tensor, "2 3"]
    """Lowest and highest corner of the foreground in that frame (central_box)."""
    walls: Float64[Tensor, "2 3"]
    """Lower and upper walls of the cell in contracted units, in [0, 1]."""

    @property
    def centre(self) -> Float64[Tensor, "3"]:
        """The cell's middle in contracted units: it tells cells apart."""
        return self.walls.mean(dim=0)

    def distance(self, points: Float64[Tensor, "n 3"]) -> Float64[Tensor, " n"]:
        """d(p) of each position."""
        unit = contract(points @ self.frame.T, Box(low=self.foreground[0], high=self.foreground[1]))
        half = (self.walls[1] - self.walls[0]) / 2
        return ((unit - self.walls.mean(dim=0)) / half).abs().amax(dim=1)


AnyRegion = OrientedRegion | GroundRegion | ContractedRegion | VoxelRegion


def nearest_region(
    regions: Sequence[Region], positions: Float64[Tensor, "n 3"]
) -> Int64[Tensor, " n"]:
    """Block with the smallest d(p), the first of equals: who owns each place, in or out of a core.

    Args:
        regions: Where each block lies, in the order of the blocks.
        positions: Places in the scene's frame.
    """
    best = torch.full((len(positions),), torch.inf, dtype=torch.float64)
    owner = torch.zeros(len(positions), dtype=torch.int64)
    for index, region in enumerate(regions):
        away = region.distance(positions)
        owner[away < best] = index
        best = best.minimum(away)
    return owner


def save_regions(path: Path, regions: Sequence[AnyRegion]) -> None:
    """Write regions, in order, into one file that is there whole or not at all.

    Args:
        path: The file; one that is there is replaced.
        regions: Where each block lies, in the order of the blocks.
    """
    tensors: dict[str, Tensor] = {}
    kinds: list[dict[str, object]] = []
    for i, region in enumerate(regions):
        shapes: dict[str, list[int]] = {}
        kinds.append({"kind": type(region).__name__, "deflated": shapes})
        for name, value in vars(region).items():
            if isinstance(value, OrientedBox):
                tensors |= {f"{i}.{name}.{key}": part.clone() for key, part in vars(value).items()}
            elif isinstance(value, Tensor) and value.dtype == torch.bool:
                tensors[f"{i}.{name}"] = deflated(value.to(torch.uint8))
                shapes[name] = list(value.shape)
            elif isinstance(value, Tensor):
                tensors[f"{i}.{name}"] = value.clone()
            elif value is not None:
                kinds[-1][name] = value
    write_tensors(path, tensors, {"format": KIND, "version": VERSION, "regions": kinds})


def load_regions(path: Path) -> tuple[AnyRegion, ...]:
    """The regions that save_regions wrote.

    Raises: DataError for a file that is missing, damaged, foreign or of another version.
    """
    tensors, facts = read_tensors(path)
    if not isinstance(facts, dict) or facts.get("format") != KIND:
        raise DataError(f"{path}: not a file of block regions (no format {KIND!r})")
    if facts.get("version") not in READ:
        raise DataError(
            f"{path}: version {facts.get('version')!r}, this splatproof reads 1 to {VERSION}"
        )
    known = {kind.__name__: kind for kind in get_args(AnyRegion)}
    regions = []
    try:
        for i, entry in enumerate(facts["regions"]):
            shapes = entry.get("deflated", {})
            values = {key: value for key, value in entry.items() if key not in ("kind", "deflated")}
            boxes: dict[str, dict[str, Tensor]] = {}
            for name, tensor in tensors.items():
                first, field, *rest = name.split(".")
                if first == str(i) and rest:
                    boxes.setdefault(field, {})[rest[0]] = tensor
                elif first == str(i) and field in shapes:
                    shape = tuple(int(size) for size in shapes[field])
                    values[field] = inflated(tensor, math.prod(shape)).reshape(shape).bool()
                elif first == str(i):
                    values[field] = tensor
            values |= {field: OrientedBox(**parts) for field, parts in boxes.items()}
            regions.append(known[entry["kind"]](**values))
    except (
        AttributeError, KeyError, OverflowError, RuntimeError, TypeError, ValueError,
    ) as error:  # fmt: skip
        raise DataError(f"{path}: damaged ({error!r})") from None
    return tuple(regions)
