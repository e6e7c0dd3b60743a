"""Twin of reference.stitching.stochastic for blocks of millions: from disk, one block in memory at a time."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64, UInt8
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.methods.city.block_model import BlockModel
from splatproof.methods.city.voxel_region import VoxelRegion
from splatproof.methods.storage.morton import morton_order
from splatproof.reference.partition.boxes import Region, WidenedRegion
from splatproof.reference.stitching.stochastic import (
    COMPETITIVE,
    CORE,
    DROPPED,
    StitchSettings,
    TrainedBlock,
    keep_probability,
    quality,
    shares,
    weight,
    zones,
)

SCORED = ("means", "opacity_logits", "log_scales")
WALL = 1e-9
"""So near to d = 1 a place may be in two cores, or in none, by rounding."""
BEYOND = 1.2
"""Distances are not told apart from here on: all of them are beyond the rim."""
Outside = Literal["drop", "nearest"]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rim:
    """The primitives of one block that compete."""

    rows: Int64[Tensor, " m"]
    """Their indices in the block."""
    means: Float64[Tensor, "m 3"]
    distance: Float64[Tensor, " m"]
    quality: Float64[Tensor, " m"]


def stitch(
    blocks: Sequence[BlockModel],
    settings: StitchSettings,
    generator: torch.Generator,
    *,
    threads: int | None = None,
) -> tuple[Bool[Tensor, " _"], ...]:
    """Twin of reference.stitching.stochastic.stitch: same generator state, same kept set; rims are O(n log n).

    Held at once: the rims of all blocks (64 bytes a competitive primitive), one block's positions
    and qualities (32 bytes a primitive) with their k-d tree, and a byte a primitive of the answer.
    Every block's numbers are drawn in the order of the regions' centres, for all its primitives, so
    neither the order of the blocks nor what competes changes the number that a primitive gets.

    Args:
        blocks: All blocks; their order does not matter.
        settings: How they compete.
        generator: Source of the draws.
        threads: Number of threads of the neighbour search; None: one for each core. Results do not
            depend on it.

    Returns: Which primitives of each block stay.

    Raises: UsageError for settings without sense; DataError for damaged block models.

    Source: StitchGS, Sec. 3.2.3.
    """
    if settings.neighbours < 1 or not 0 <= settings.sharpness < float("inf"):
        raise UsageError(f"{settings}: expected neighbours >= 1 and a finite sharpness >= 0")
    zoned = [_zones_and_rim(block, settings) for block in blocks]
    rims = [rim for _, rim in zoned]
    unit = _unit(rims, settings)
    start = -torch.inf if settings.keep_unopposed else 0.0
    rivals = [torch.full((len(rim.rows),), start, dtype=torch.float64) for rim in rims]
    workers = threads or os.cpu_count() or 1
    for j, other in enumerate(blocks):
        _compete(other, zoned[j][0], j, rims, rivals, unit, settings, workers)
    kept = [torch.zeros(0, dtype=torch.bool)] * len(blocks)
    for i in sorted(range(len(blocks)), key=lambda i: blocks[i].region.centre.tolist()):
        zone, rim = zoned[i]
        draw = torch.rand(len(zone), generator=generator, dtype=torch.float64)
        own = weight(rim.distance) * (rim.quality / unit)
        chance = keep_probability(own, rivals[i], settings.sharpness)
        chance = torch.where(rivals[i].isneginf(), 1.0, chance)
        kept[i] = zone == CORE
        kept[i][rim.rows] = draw[rim.rows] < chance
    return tuple(kept)


def block_shares(blocks: Sequence[BlockModel]) -> tuple[Float64[Tensor, " _"], ...]:
    """What each block has of the place of each of its primitives, see reference.stitching.stochastic.shares.

    Args:
        blocks: All blocks; their order does not matter.

    Returns: Shares in [0, 1] for each block; 0 where the primitive lies beyond its rim.

    Source: ours.
    """
    found = []
    for i, block in enumerate(blocks):
        parts = [torch.zeros(0, dtype=torch.float64)]
        for part in block.slices(("means",)):
            means = part["means"].double()
            away = torch.stack([_clipped(other.region, means, 0.0) for other in blocks])
            parts.append(shares(away)[i])
        found.append(torch.cat(parts))
    return tuple(found)


def draw_shares(
    blocks: Sequence[BlockModel],
    held: Sequence[Float64[Tensor, " _"]],
    generator: torch.Generator,
) -> tuple[Bool[Tensor, " _"], ...]:
    """Keep each primitive with the probability of its share; one number each, drawn as `stitch` draws.

    Args:
        blocks: All blocks; the order of their regions' centres is that of the draws.
        held: Their shares (block_shares).
        generator: Source of the draws.

    Source: ours.
    """
    kept = [torch.zeros(0, dtype=torch.bool)] * len(blocks)
    for i in sorted(range(len(blocks)), key=lambda i: blocks[i].region.centre.tolist()):
        kept[i] = torch.rand(len(held[i]), generator=generator, dtype=torch.float64) < held[i]
    return tuple(kept)


def widened(blocks: Sequence[BlockModel], overlap: float) -> tuple[BlockModel, ...]:
    """The blocks with cores that overlap: all distances to a block are to one 1 + overlap times as large.

    Args:
        blocks: All blocks.
        overlap: Share by which each is larger, >= 0; 0 changes no distance.

    Source: see reference.stitching.stochastic.overlapping.
    """
    return tuple(
        replace(block, region=WidenedRegion(region=block.region, margin=overlap))
        for block in blocks
    )


def cut_hard(
    blocks: Sequence[BlockModel], outside: Outside = "drop", overlap: float = 0.0
) -> tuple[Bool[Tensor, " _"], ...]:
    """Hard merge: block i keeps what lies in its core; where cores touch, the first nearest block.

    Args:
        blocks: All blocks; of two at the same distance the first one keeps a place.
        outside: What lies in no core is dropped ("drop"), as in the papers, or kept by the block
            that is nearest to it ("nearest").
        overlap: Share by which cores reach beyond their blocks, >= 0; what lies there is kept by all whose core it is, see
            reference.stitching.stochastic.overlapping.

    Returns: Which primitives of each block stay; without an overlap no place is kept by two blocks.

    Source: CityGaussian, Sec. 3.2; VastGaussian, Sec. 4.3; StitchGS, Sec. 4 (hard cuts).
    """
    return tuple(
        torch.cat(
            [
                _owned(blocks, i, part["means"].double(), outside, overlap)
                for part in block.slices(("means",))
            ]
            or [torch.zeros(0, dtype=torch.bool)]
        )
        for i, block in enumerate(blocks)
    )


def _owned(
    blocks: Sequence[BlockModel],
    block: int,
    means: Float64[Tensor, "n 3"],
    outside: Outside,
    overlap: float,
) -> Bool[Tensor, " n"]:
    """Which places the block keeps; the others' distances are asked for only where it is not clear."""
    away = blocks[block].region.distance(means)
    kept = away <= 1
    open_ = (away >= 1 - WALL) if outside == "nearest" else (away >= 1 - WALL) & kept
    rows = open_.nonzero()[:, 0]
    mine = torch.ones(len(rows), dtype=torch.bool)
    for j, other in enumerate(blocks):
        if j != block and len(rows):
            theirs = other.region.distance(means[rows])
            mine &= theirs >= away[rows] if j > block else theirs > away[rows]
    kept[rows] = mine
    return kept | ((away > 1) & (away <= 1 + overlap))


def _zones_and_rim(block: BlockModel, settings: StitchSettings) -> tuple[UInt8[Tensor, " n"], _Rim]:
    """Zone of each primitive, and the competitive ones."""
    zone, parts, start = [torch.zeros(0, dtype=torch.uint8)], [], 0
    for part in block.slices(SCORED):
        means = part["means"].double()
        away = _clipped(block.region, means, 1.0)
        zone.append(zones(away).to(torch.uint8))
        rows = (zone[-1] == COMPETITIVE).nonzero()[:, 0]
        scored = _quality(block, {name: values[rows] for name, values in part.items()}, settings)
        parts.append((rows + start, means[rows], away[rows], scored))
        start += len(means)
    if not parts:
        none = torch.zeros(0, dtype=torch.float64)
        return zone[0], _Rim(
            rows=none.long(), means=none.reshape(0, 3), distance=none, quality=none
        )
    rows, means, away, scored = (torch.cat(column) for column in zip(*parts, strict=True))
    return torch.cat(zone), _Rim(rows=rows, means=means, distance=away, quality=scored)


def near_walls(
    places: Float64[Tensor, "n 3"], regions: Sequence[Region], reach: float
) -> Bool[Tensor, " n"]:
    """Places that lie within a normalised distance of 1 + reach of two regions or more.

    Where regions tile the scene, that is a strip on both sides of each wall between two of them; at the
    scene's own border there is no wall.

    Args:
        places: Positions in the scene's frame.
        regions: Regions of the blocks.
        reach: Half the width of the strip, > 0.

    Source: ours; the band is that of metrics.seam_partition at a reach of 0.1.
    """
    held = torch.zeros(len(places), dtype=torch.int64)
    for region in regions:
        held += _clipped(region, places, 1.0, 1 + 2 * reach) <= 1 + reach
    return held >= 2


def _clipped(
    region: Region, points: Float64[Tensor, "n 3"], low: float, high: float = BEYOND
) -> Float64[Tensor, " n"]:
    """Distances between `low` and `high`, which others may be taken for: nothing here asks for them."""
    if isinstance(region, WidenedRegion):
        times = 1 + region.margin
        return _clipped(region.region, points, low * times, high * times) / times
    if isinstance(region, VoxelRegion):
        return region.clipped(points, low, high)
    return region.distance(points)


def _quality(
    block: BlockModel, part: dict[str, Tensor], settings: StitchSettings
) -> Float64[Tensor, " n"]:
    """Q of some primitives of the block."""
    return quality(TrainedBlock(box=block.region, **part), settings)


def _unit(rims: Sequence[_Rim], settings: StitchSettings) -> Float64[Tensor, ""]:
    """What qualities are divided by: their median over all that competes, or 1."""
    one = torch.ones((), dtype=torch.float64)
    if not settings.normalise or not sum(len(rim.rows) for rim in rims):
        return one
    unit = torch.cat([rim.quality for rim in rims]).median()
    return unit if unit > 0 else one


def _compete(
    other: BlockModel,
    zone: UInt8[Tensor, " n"],
    index: int,
    rims: Sequence[_Rim],
    rivals: Sequence[Float64[Tensor, " _"]],
    unit: Float64[Tensor, ""],
    settings: StitchSettings,
    workers: int,
) -> None:
    """Raise the rivals' scores of all other rims by what the block has near them."""
    reach = {
        i: weight(_clipped(other.region, rim.means, 0.0))
        for i, rim in enumerate(rims)
        if i != index and len(rim.rows)
    }
    reach = {i: w for i, w in reach.items() if bool((w > 0).any())}
    alive = zone != DROPPED
    if not reach or not bool(alive.any()):
        return
    means, scored, start = [], [], 0
    for part in other.slices(SCORED):
        held = alive[start : start + len(part["means"])]
        start += len(held)
        part = {name: values[held] for name, values in part.items()}
        means.append(part["means"].double())
        scored.append(_quality(other, part, settings) / unit)
    qualities = torch.cat(scored)
    tree = KDTree(torch.cat(means).numpy())
    count = min(settings.neighbours, tree.n)
    for i, w in reach.items():
        near = (w > 0).nonzero()[:, 0]
        near = near[morton_order(rims[i].means[near])]  # neighbours in a row share the tree's nodes
        for rows in near.split(2**18):
            found = tree.query(rims[i].means[rows].numpy(), k=count, workers=workers)[1]
            ids = torch.from_numpy(np.asarray(found, dtype=np.int64)).reshape(len(rows), count)
            score = w[rows] * qualities[ids].mean(dim=1)
            rivals[i][rows] = rivals[i][rows].maximum(score)
