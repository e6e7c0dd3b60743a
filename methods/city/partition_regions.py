"""From a partition to the regions of its blocks."""

from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.city.regions import ContractedRegion, GroundRegion, OrientedRegion
from splatproof.methods.city.voxel_region import VoxelRegion
from splatproof.reference.partition.boxes import Box
from splatproof.reference.partition.camera_cells import CameraGrid
from splatproof.reference.partition.density_split import Rectangles, oriented_boxes
from splatproof.reference.partition.odbp import OdbpPartition
from splatproof.reference.partition.voxel_graph import voxel_centres

MOST_CELLS = 2**22
"""Cells of the grid over a whole scene; voxels that were halved further are rounded to it."""
Rims = Literal["block", "scene"]
"""What the distance to a block of voxels is relative to. block: half the box around it, which one
far-off voxel widens; scene: half of a K-th of the scene's ground, all of its height, for all blocks."""
TRIM, RIM = 0.01, 0.2
"""Share of the points that may lie beyond the grid on each side of each axis, and what it is then
widened by on each side: few far points must not make it coarse."""


def voxel_regions(
    partition: OdbpPartition,
    frame: Float64[Tensor, "3 3"],
    *,
    open_: bool = True,
    most_cells: int = MOST_CELLS,
    rims: Rims = "scene",
) -> tuple[VoxelRegion, ...]:
    """Regions of ODBP's blocks: their voxels, and the empty ones to which theirs are nearest.

    Primitives move and appear between the voxels that sparse points occupied; filling the space
    between them gives every place of the scene an owner, as odbp.owner does. Where voxels of
    several sizes meet, a cell of the grid belongs to the block with the most load in it.

    Args:
        partition: Blocks of voxels in the ground frame.
        frame: Rotation from the scene into the ground frame (ground_frame).
        open_: The outermost cells reach to infinity; False ends the blocks with the grid.
        most_cells: Cells are halved with the voxels as long as the grid holds no more than this.
        rims: What distances to a block are relative to.

    Returns: A region for each block, in their order.

    Raises: DataError for a block without voxels.

    Source: ours.
    """
    count = len(partition.loads)
    for trim in (TRIM, 0.0):
        low, high = _grid_bounds(partition, trim)
        labels, level = _labelled_grid(partition, low, high, most_cells)
        if len(np.unique(labels)) == count:
            break
    else:
        raise DataError(
            f"{count} blocks, of which {count - len(np.unique(labels))} have no voxel on a grid of "
            f"{labels.size} cells: ask for fewer blocks or larger voxels"
        )
    side = partition.voxel_size / 2.0**level
    origin = torch.from_numpy(partition.origin + low * partition.voxel_size)
    size = torch.tensor(labels.shape, dtype=torch.float64) * side
    bounds = torch.stack([origin, origin + size]) if open_ else None
    share = (size[:2].prod() / count).sqrt()
    unit = torch.stack([share, share, size[2]]) / 2 if rims == "scene" else None
    regions = []
    for block in range(count):
        held = labels == block
        spans = [np.flatnonzero(held.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
        cut = tuple(slice(span[0], span[-1] + 1) for span in spans)
        first = torch.tensor([float(span[0]) for span in spans], dtype=torch.float64)
        regions.append(
            VoxelRegion(
                frame=frame, low=origin + first * side, side=side, bounds=bounds,
                cells=torch.from_numpy(held[cut].copy()), unit=unit,
            )
        )  # fmt: skip
    return tuple(regions)


def oriented_regions(
    rectangles: Rectangles,
    frame: Float64[Tensor, "3 3"],
    heights: tuple[float, float],
    *,
    open_: bool = True,
) -> tuple[OrientedRegion, ...]:
    """Regions of rectangles that tile a root, between two heights.

    Args:
        rectangles: On the ground of `frame` (density_split.split).
        frame: Rotation from the scene into the ground frame.
        heights: Lower and upper bound in scene units (density_split.height_bounds).
        open_: What lies beyond the root or the heights belongs to the nearest block; False ends the
            blocks there, as the paper does.

    Raises: DataError for a rectangle or a height without extent.

    Source: StitchGS, Sec. 3.2.1.
    """
    root = replace(rectangles, lows=rectangles.root[:1], highs=rectangles.root[1:])
    (whole,) = oriented_boxes(root, frame, heights)
    boxes = oriented_boxes(rectangles, frame, heights)
    return tuple(OrientedRegion(box=box, bounds=whole if open_ else None) for box in boxes)


def ground_regions(grid: CameraGrid, frame: Float64[Tensor, "3 3"]) -> tuple[GroundRegion, ...]:
    """Regions of the camera-balanced grid; the outermost cells reach to infinity.

    Args:
        grid: Walls of its columns, and of the rows in each, in scene units on the ground of
            `frame`.
        frame: Rotation from the scene into the ground frame (ground_frame).

    Source: VastGaussian, Sec. 4.1.
    """
    columns, rows = grid.shape
    regions = []
    for block in range(columns * rows):
        x, y = grid.column_walls[[0, -1]], grid.row_walls[block // rows][[0, -1]]
        bounds = torch.stack([x, y], dim=1).double()
        regions.append(GroundRegion(frame=frame, corners=grid.cell(block).double(), bounds=bounds))
    return tuple(regions)


def contracted_regions(
    foreground: Box, cells: tuple[int, int, int], frame: Float64[Tensor, "3 3"]
) -> tuple[ContractedRegion, ...]:
    """Regions of the grid in contracted space, numbered as contracted_grid.cell_of does.

    Args:
        foreground: What the contraction leaves as it is, in the ground frame (central_box).
        cells: Number of cells along x, y and z, each >= 1.
        frame: Rotation from the scene into the ground frame (ground_frame).

    Source: CityGaussian, Sec. 3.2.
    """
    corners = torch.stack([foreground.low, foreground.high]).double()
    count = torch.tensor(cells, dtype=torch.float64)
    regions = []
    for z, y, x in np.ndindex(cells[::-1]):
        at = torch.tensor([x, y, z], dtype=torch.float64)
        walls = torch.stack([at, at + 1]) / count
        regions.append(ContractedRegion(frame=frame, foreground=corners, walls=walls))
    return tuple(regions)


def _grid_bounds(
    partition: OdbpPartition, trim: float
) -> tuple[Int64[np.ndarray, "3"], Int64[np.ndarray, "3"]]:
    """Lowest and highest corner of the scene's grid in whole voxels, without far points."""
    graph = partition.graph
    scale = 2.0 ** graph.levels[:, None]
    low = np.floor((graph.cells / scale).min(axis=0))
    high = np.ceil(((graph.cells + 1) / scale).max(axis=0))
    points = voxel_centres(graph.levels, graph.cells)[graph.voxel_of_point]
    inner_low, inner_high = np.quantile(points, [trim, 1 - trim], axis=0)
    rim = RIM * (inner_high - inner_low)
    low = np.maximum(low, np.floor(inner_low - rim))
    high = np.minimum(high, np.ceil(inner_high + rim))
    return low.astype(np.int64), np.maximum(high, low + 1).astype(np.int64)


def _labelled_grid(
    partition: OdbpPartition,
    low: Int64[np.ndarray, "3"],
    high: Int64[np.ndarray, "3"],
    most_cells: int,
) -> tuple[Int64[np.ndarray, "x y z"], int]:
    """Block of each cell of the grid, and how often the voxels were halved to get its cells."""
    graph = partition.graph
    level = int(graph.levels.max())
    while np.prod(np.ceil((high - low) * 2.0**level)) > most_cells:
        level -= 1
    shape = np.ceil((high - low) * 2.0**level).astype(np.int64)
    labels = np.full(shape, -1, dtype=np.int64)
    scale = 2.0 ** (level - graph.levels[:, None])
    first = graph.cells * scale - low * 2.0**level
    for depth in np.unique(graph.levels):
        rows = np.flatnonzero(graph.levels == depth)
        if depth < level:  # a voxel of many cells
            inner = np.stack(np.unravel_index(np.arange(8 ** (level - depth)),
                                              [2 ** (level - depth)] * 3), axis=1)  # fmt: skip
            cells = (first[rows, None].astype(np.int64) + inner).reshape(-1, 3)
            owners = np.repeat(partition.voxel_labels[rows], len(inner))
            held = ((cells >= 0) & (cells < shape)).all(axis=1)
            labels[tuple(cells[held].T)] = owners[held]
    small = graph.levels >= level
    cells = np.floor(first[small]).astype(np.int64)
    held = ((cells >= 0) & (cells < shape)).all(axis=1)
    _vote(labels, cells[held], partition.voxel_labels[small][held], graph.weights[small][held])
    nearest = distance_transform_edt(labels < 0, return_distances=False, return_indices=True)
    return labels[tuple(np.asarray(nearest))], level


def _vote(
    labels: Int64[np.ndarray, "x y z"],
    cells: Int64[np.ndarray, "n 3"],
    owners: Int64[np.ndarray, " n"],
    weights: Int64[np.ndarray, " n"],
) -> None:
    """Label each cell with the block that has most load in it, the first of equals."""
    blocks = int(owners.max(initial=0)) + 1
    flat = np.ravel_multi_index(tuple(cells.T), labels.shape)
    keys, place = np.unique(flat * blocks + owners, return_inverse=True)
    load = np.bincount(place.reshape(-1), weights=weights, minlength=len(keys))
    order = np.lexsort((-keys, load))  # the last entry for a cell wins
    labels.reshape(-1)[keys[order] // blocks] = keys[order] % blocks
