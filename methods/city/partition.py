"""Cut a scene into blocks: who owns each point, where each block lies, which views train it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.city.citygaussian_views import coarse_change, point_model
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.partition_regions import (
    Rims,
    contracted_regions,
    ground_regions,
    oriented_regions,
    voxel_regions,
)
from splatproof.methods.city.regions import AnyRegion
from splatproof.methods.training.schedules import require
from splatproof.reference.partition import camera_cells as partition_cameras
from splatproof.reference.partition import contracted_grid as partition_grid
from splatproof.reference.partition import density_split as partition_density
from splatproof.reference.partition import odbp
from splatproof.reference.partition.camera_cells import CameraGrid
from splatproof.reference.partition.density_split import DensitySettings
from splatproof.reference.partition.metis import cut_size
from splatproof.reference.partition.odbp import OdbpPartition, OdbpSettings
from splatproof.reference.partition.visibility import covering_views
from splatproof.reference.partition.voxel_graph import grid_coordinates, voxel_graph
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

Balance = Literal["load", "time"]
MethodName = Literal["odbp", "blockgaussian", "vastgaussian", "citygaussian"]


@dataclass(frozen=True, kw_only=True)
class PartitionSettings:
    """How a scene is cut into blocks, and which views train each of them."""

    method: MethodName = "odbp"
    """What the cut aims at. odbp: equal rendering load over voxels (DPGS); blockgaussian:
    rectangles halved by point density; vastgaussian: equally many cameras; citygaussian: uniform
    grid in contracted space."""
    voxel_size: float | None = None
    """odbp: side of a voxel in scene units; None: a 64th of the scene's longer side on the
    ground."""
    balance: Balance = "load"
    """odbp: what the blocks share evenly. load: what their views see of them (DPGS, Eq. 5); time: what they will
    take to train, predicted from steps, pixels, Gaussians and what views see (ours)."""
    imbalance: float = 0.01
    """odbp: share of their mean by which the blocks' loads may differ from it (the paper: 0.05)."""
    seeds: int = 10
    """odbp: number of METIS seeds that are tried; the best cut stays."""
    margin: float = 0.05
    """odbp, blockgaussian, and all that start from a coarse model: share of its extent by which a block
    is widened; it trains the points, or the coarse Gaussians, in the widened block (the paper
    BlockGaussian: 0.05, StitchGS' release: 0.15)."""
    rims: Rims = "scene"
    """odbp: what the width of a block's margin and rim is a share of. block: half the box around the
    block, which one far-off voxel widens; scene: half of a K-th of the scene's ground, and of its
    height, for all blocks."""
    view_share: float = 0.3
    """odbp, blockgaussian: a view trains a block that holds at least this share of the points that
    the view sees (tau_view; the releases: 0.3)."""
    block_share: float = 0.1
    """odbp, blockgaussian: a view also trains a block if it sees at least this share of the block's
    points (tau_block; BlockGaussian's release: 0.1, StitchGS': 0.05)."""
    change: float = 0.08
    """citygaussian: a view also trains a block without which its image changes by more than this,
    measured by 1 - SSIM (published: 0.05 to 0.12)."""

    def __post_init__(self) -> None:
        """Refuse settings that no partition can follow."""
        size = self.voxel_size
        require(size is None or size > 0, "partition.voxel_size", size, "> 0 or None")
        fits = self.balance == "load" or self.method == "odbp"
        require(fits, "partition.balance", self.balance, "'load'; only odbp cuts by time")
        require(self.imbalance > 0, "partition.imbalance", self.imbalance, "> 0")
        require(self.seeds >= 1, "partition.seeds", self.seeds, ">= 1")
        require(self.margin >= 0, "partition.margin", self.margin, ">= 0")
        for name in ("view_share", "block_share", "change"):
            value = getattr(self, name)
            require(0 <= value <= 1, f"partition.{name}", value, "0 to 1")


@dataclass(frozen=True, kw_only=True, eq=False)
class Partition:
    """One partition of a scene's points and training views."""

    method: str
    """Name of the partition."""
    labels: Int64[Tensor, " n"]
    """Block of each sparse point; blocks may be empty."""
    views: tuple[Bool[Tensor, " v"], ...]
    """For each block, which of all views it trains on."""
    points: tuple[Bool[Tensor, " n"], ...] = ()
    """For each block, the sparse points that it trains and densifies; all that it owns are there."""
    regions: tuple[AnyRegion, ...] = ()
    """Where each block lies, in the scene's frame."""
    note: str = ""
    """What went wrong, in one line; empty if nothing did."""


def partition(
    scene: Scene,
    blocks: int,
    settings: PartitionSettings,
    *,
    backend: str = "cpu",
    coarse: Gaussians | None = None,
) -> Partition:
    """Cut a scene into K blocks. One block is the whole scene: all views, all points.

    Args:
        scene: With training views, and sparse points with their tracks.
        blocks: Number K of blocks, >= 1.
        settings: Which partition, and its thresholds.
        backend: Name of the rasterizer for CityGaussian's rule; the others draw nothing.
        coarse: CityGaussian's coarse model in the scene's frame; None: one Gaussian a sparse point.

    Raises: UsageError for K < 1; DataError for more blocks than there are distinct points (odbp) or
        training cameras (vastgaussian), or a scene without views or points.
    """
    require(blocks >= 1, "blocks", blocks, ">= 1")
    place = ground(scene, settings.voxel_size)
    if settings.method == "odbp":
        found = odbp_blocks(place, blocks, "odbp", settings=settings)
    elif settings.method == "blockgaussian":
        found = blockgaussian_blocks(place, blocks, settings)
    elif settings.method == "vastgaussian":
        found = vastgaussian_blocks(place, blocks)
    else:
        found = citygaussian_blocks(place, blocks, backend, settings.change, coarse)
    if blocks == 1:
        every = torch.ones_like(place.loads, dtype=torch.bool)
        return Partition(
            method=found.method, labels=found.labels, views=(place.trained,), points=(every,),
            regions=found.regions, note=found.note,
        )  # fmt: skip
    return found


def check_blocks(scene: Scene, blocks: int, settings: PartitionSettings) -> None:
    """Refuse, before a coarse model is trained, more blocks than there is a scene for.

    Args:
        scene: With training views and sparse points.
        blocks: Number K of blocks, >= 1.
        settings: Which partition.

    Raises: DataError for more blocks than training cameras (vastgaussian) or points (odbp), or a scene without
        views or points.
    """
    place = ground(scene, settings.voxel_size)
    if settings.method == "vastgaussian":
        _camera_grid(place, blocks)
    elif settings.method == "odbp" and blocks > len(scene.points):
        raise DataError(f"{blocks} blocks for {len(scene.points)} points: ask for fewer")


def near_square(blocks: int) -> tuple[int, int]:
    """Columns x rows = blocks with columns >= rows, as near to a square as there is.

    Args:
        blocks: Number of cells, >= 1.
    """
    rows = next(n for n in range(int(blocks**0.5), 0, -1) if blocks % n == 0)
    return blocks // rows, rows


def odbp_blocks(place: Ground, blocks: int, name: str, *, settings: PartitionSettings) -> Partition:
    """ODBP's blocks; views by the points a widened block holds, with BlockGaussian's shares.

    DPGS does not say how views are assigned. Its auxiliary box is no help: the bounds of a ragged
    block with one stray point can span the scene, and ghosts are not what a block is trained for.

    Args:
        place: The scene; its voxel size is the partition's.
        blocks: Number K of blocks, >= 1.
        name: What the partition is called.
        settings: Imbalance, seeds, margin and the two shares count.

    Source: DPGS, Sec. 3.3; views: BlockGaussian's release.
    """
    found = odbp.partition(
        place.positions, place.loads,
        OdbpSettings(blocks=blocks, voxel_size=place.voxel_size, imbalance=settings.imbalance,
                     seeds=settings.seeds),
    )  # fmt: skip
    regions = voxel_regions(found, place.frame, rims=settings.rims)
    points = _widened(place, found.labels, regions, settings.margin)
    return Partition(
        method=name, labels=found.labels, regions=regions, note=_note(found), points=points,
        views=_covering(place, list(points), settings),
    )  # fmt: skip


def blockgaussian_blocks(place: Ground, blocks: int, settings: PartitionSettings) -> Partition:
    """BlockGaussian's rectangles, halved by the fullest until there are K.

    Blocks with few points or views are kept, though the release drops them: what they cover would
    be in no block.

    Args:
        place: The scene.
        blocks: Number K of blocks, >= 1.
        settings: Margin and the two shares count.

    Source: BlockGaussian, Sec. 3.2, and its release.
    """
    depth = blocks  # K leaves need at most K - 1 halvings in a row
    halving = DensitySettings(max_points=0, max_depth=depth, max_blocks=blocks)
    ground_positions = place.positions[:, :2]
    found = partition_density.split(ground_positions, halving)
    heights = partition_density.height_bounds(place.positions[:, 2])
    regions = oriented_regions(found, place.frame, heights)
    labels = partition_density.owner_rectangle(found, ground_positions)
    points = _widened(place, labels, regions, settings.margin)
    return Partition(
        method="blockgaussian", labels=labels, regions=regions, points=points,
        views=_covering(place, list(points), settings),
    )  # fmt: skip


def vastgaussian_blocks(place: Ground, blocks: int) -> Partition:
    """VastGaussian's cells over the training cameras, with its visibility-based selection.

    Args:
        place: The scene.
        blocks: Number K of blocks, >= 1; the grid is as near to a square as K allows.

    Raises: DataError for more blocks than training cameras.

    Source: VastGaussian, Sec. 4.1.
    """
    cameras = tuple(view.camera for view in place.scene.train_views)
    grid = _camera_grid(place, blocks)
    labels = partition_cameras.owner_cell(grid, place.positions[:, :2])
    views, points = [], []
    for block in range(blocks):
        found = partition_cameras.select(
            grid, block, place.frame, cameras, place.scene.points.positions
        )
        views.append(torch.zeros_like(place.trained).masked_scatter(place.trained, found.views))
        points.append(found.points | (labels == block))
    return Partition(
        method="vastgaussian", labels=labels, views=tuple(views), points=tuple(points),
        regions=ground_regions(_reaching(grid, place.positions[:, :2]), place.frame),
    )  # fmt: skip


def citygaussian_blocks(
    place: Ground,
    blocks: int,
    backend: str,
    threshold: float = PartitionSettings.change,
    coarse: Gaussians | None = None,
) -> Partition:
    """CityGaussian's uniform grid in contracted space, views by the change of a coarse model.

    Cells are not grown to hold 25,000 Gaussians before the change is measured: in a scene with
    fewer than some hundred thousand that would be most of it. Every block starts from all points.

    Args:
        place: The scene.
        blocks: Number K of blocks, >= 1; the grid is as near to a square as K allows.
        backend: Name of the rasterizer that draws the coarse model.
        threshold: Change of a view's image without a block, 1 - SSIM, above which it trains the
            block.
        coarse: The coarse model in the scene's frame; None: one Gaussian a sparse point.

    Source: CityGaussian, Sec. 3.2.
    """
    foreground = partition_grid.central_box(place.positions)
    cells = (*near_square(blocks), 1)
    unit = partition_grid.contract(place.positions, foreground)
    model = coarse or point_model(place)
    of_model = partition_grid.contract(model.means.double() @ place.frame.T, foreground)
    centres = torch.stack([view.camera.centre for view in place.scene.views]) @ place.frame.T
    inside = partition_grid.contract(centres, foreground)
    change = coarse_change(place, backend, model)
    chosen = []
    for cell in range(blocks):
        grown = partition_grid.grown_cell(of_model, cells, cell, enough=0)
        chosen.append(
            place.trained
            & partition_grid.needed_views(
                inside, cells, cell, lambda v, held=grown: change(v, held), threshold=threshold
            )
        )
    return Partition(
        method="citygaussian", labels=partition_grid.cell_of(unit, cells), views=tuple(chosen),
        points=(torch.ones(len(unit), dtype=torch.bool),) * blocks,
        regions=contracted_regions(foreground, cells, place.frame),
    )  # fmt: skip


def _camera_grid(place: Ground, blocks: int) -> CameraGrid:
    """VastGaussian's grid over the training cameras."""
    centres = torch.stack([view.camera.centre for view in place.scene.train_views])
    return partition_cameras.camera_grid((centres @ place.frame.T)[:, :2], *near_square(blocks))


def _reaching(grid: CameraGrid, ground: Float64[Tensor, "n 2"]) -> CameraGrid:
    """The grid with its outermost walls moved out to the middle 98 % of the points.

    Outer cells own all that is beyond the flight; only what a wall's distance is measured by changes.
    Cells without width (cameras on one line) get a thousandth of the scene's.
    """
    low, high = torch.from_numpy(np.quantile(ground.numpy(), [0.01, 0.99], axis=0))
    columns, rows = grid.column_walls.clone(), grid.row_walls.clone()
    columns[0], columns[-1] = columns[0].minimum(low[0]), columns[-1].maximum(high[0])
    rows[:, 0], rows[:, -1] = rows[:, 0].minimum(low[1]), rows[:, -1].maximum(high[1])
    gap = 1e-3 * float((high - low).max().clamp(min=1e-9))
    return CameraGrid(column_walls=_apart(columns, gap), row_walls=_apart(rows, gap))


def _apart(walls: Float64[Tensor, "*lines n"], gap: float) -> Float64[Tensor, "*lines n"]:
    """Ascending walls, each moved up to at least `gap` above the one before."""
    steps = gap * torch.arange(walls.shape[-1], dtype=walls.dtype)
    return (walls - steps).cummax(dim=-1).values + steps


def _widened(
    place: Ground, labels: Int64[Tensor, " n"], regions: tuple[AnyRegion, ...], margin: float
) -> tuple[Bool[Tensor, " n"], ...]:
    """Points in each region widened by a margin, and those that the block owns."""
    positions: Float64[Tensor, "n 3"] = place.scene.points.positions
    return tuple(
        (region.distance(positions) <= 1 + margin) | (labels == block)
        for block, region in enumerate(regions)
    )


def _covering(
    place: Ground, held: list[Bool[Tensor, " n"]], settings: PartitionSettings
) -> tuple[Bool[Tensor, " v"], ...]:
    """Training views that cover the points of each block by either of the two shares."""
    return tuple(
        place.trained
        & covering_views(
            place.scene.points, points, len(place.scene.views),
            view_share=settings.view_share, block_share=settings.block_share,
        )
        for points in held
    )  # fmt: skip


def _note(found: OdbpPartition) -> str:
    """What to say of a partition whose loads miss the bound."""
    if found.balanced:
        return ""
    return f"loads differ from the mean by up to {found.worst:.1%}; the bound could not be met"


def edge_cut(place: Ground, labels: Int64[Tensor, " n"], blocks: int) -> int:
    """Edges of the plain voxel grid between voxels of two blocks: one graph for all partitions of a scene.

    A voxel belongs to the block that has most of its load, by points where nobody saw any.

    Args:
        place: The scene's points and views on the ground plane.
        labels: Block of each sparse point, in [0, blocks).
        blocks: Number of blocks K.
    """
    grid = grid_coordinates(place.positions.numpy(), place.voxel_size)
    graph = voxel_graph(grid, place.loads.numpy(), np.zeros(len(grid), dtype=np.int64))
    share = np.zeros((len(graph.weights), blocks))
    np.add.at(share, (graph.voxel_of_point, labels.numpy()), place.loads.numpy() + 1e-9)
    return cut_size(graph.all_edges, share.argmax(axis=1))
