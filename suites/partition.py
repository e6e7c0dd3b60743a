"""Partitions of a scene side by side: how even the loads, how long the cuts, how many views a block."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from splatbench.datasets.resize import scale_intrinsics
from splatbench.methods.backends import get_backend
from splatbench.methods.initialise import from_points
from splatbench.metrics.ssim import ssim_3dgs
from splatbench.reference import boxes, odbp, partition_cameras, partition_density, partition_grid
from splatbench.reference.camera import Camera
from splatbench.reference.errors import UsageError
from splatbench.reference.ground_frame import ground_frame
from splatbench.reference.metis import cut_size
from splatbench.reference.odbp import OdbpPartition, OdbpSettings
from splatbench.reference.partition_density import DensitySettings
from splatbench.reference.scene import Scene
from splatbench.reference.visibility import covering_views, track_lengths
from splatbench.reference.voxel_graph import grid_coordinates, voxel_graph

VOXELS_ALONG = 64
"""Voxels along the longer side of the middle 98 % of the points, unless a size is given."""
VIEW_SHARE, BLOCK_SHARE = 0.3, 0.1
"""tau_view and tau_block of BlockGaussian's release."""
BLOCK_MARGIN = 0.05
"""BlockGaussian's release widens rectangles by this before it looks for views."""
CHANGE = 0.08
"""CityGaussian's epsilon, the middle of its published 0.05 to 0.12."""
COARSE_WIDTH = 128
"""Width in pixels of the images by which CityGaussian's rule is decided here."""
COARSE_OPACITY = 0.5
"""Opacity of the coarse model's Gaussians, one a sparse point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """One partition of a scene's points and training views."""

    method: str
    labels: Int64[Tensor, " n"]
    """Block of each sparse point; blocks may be empty."""
    views: tuple[Bool[Tensor, " v"], ...]
    """For each block, which of all views it trains on."""
    note: str = ""
    """What went wrong, in one line; empty if nothing did."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """A scene as partitions see it: in the upright frame that follows the flight."""

    scene: Scene
    frame: Float64[Tensor, "3 3"]
    positions: Float64[Tensor, "n 3"]
    loads: Int64[Tensor, " n"]
    voxel_size: float
    trained: Bool[Tensor, " v"]
    """Which views a method may train on."""


def ground(scene: Scene, voxel_size: float | None = None) -> Ground:
    """Turn the scene upright and choose the voxel size, if none is given."""
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    frame = ground_frame(scene.up, centres)
    positions = scene.points.positions @ frame.T
    if voxel_size is None:
        low, high = np.quantile(positions[:, :2].numpy(), [0.01, 0.99], axis=0)
        voxel_size = float((high - low).max()) / VOXELS_ALONG
    trained = torch.zeros(len(scene.views), dtype=torch.bool)
    trained[list(scene.train)] = True
    return Ground(
        scene=scene, frame=frame, positions=positions, voxel_size=voxel_size, trained=trained,
        loads=track_lengths(scene.points).long(),
    )  # fmt: skip


def near_square(blocks: int) -> tuple[int, int]:
    """Columns x rows = blocks with columns >= rows, as near to a square as there is."""
    rows = next(n for n in range(int(blocks**0.5), 0, -1) if blocks % n == 0)
    return blocks // rows, rows


def odbp_blocks(place: Ground, blocks: int, method: str, imbalance: float, seeds: int) -> Blocks:
    """ODBP's blocks; views by the points a block owns, with BlockGaussian's shares.

    DPGS does not say how views are assigned. Its auxiliary box is no help: the bounds of a ragged
    block with one stray point can span the scene, and ghosts are not what a block is trained for.
    """
    settings = OdbpSettings(
        blocks=blocks, voxel_size=place.voxel_size, imbalance=imbalance, seeds=seeds
    )
    found = odbp.partition(place.positions, place.loads, settings)
    held = [found.labels == block for block in range(blocks)]
    return Blocks(
        method=method, labels=found.labels, views=_covering(place, held), note=_note(found)
    )


def blockgaussian_blocks(place: Ground, blocks: int) -> Blocks:
    """BlockGaussian's rectangles, halved by the fullest until there are K.

    Blocks with few points or views are kept, though the release drops them: what they cover would
    be in no block.
    """
    depth = blocks  # K leaves need at most K - 1 halvings in a row
    settings = DensitySettings(max_points=0, max_depth=depth, max_blocks=blocks)
    ground_positions = place.positions[:, :2]
    found = partition_density.split(ground_positions, settings)
    heights = partition_density.height_bounds(place.positions[:, 2])
    upright = torch.eye(3, dtype=torch.float64)
    around = partition_density.oriented_boxes(found, upright, heights)
    wide = [boxes.widen_oriented(box, BLOCK_MARGIN) for box in around]
    held = [boxes.box_distance(box, place.positions) <= 1 for box in wide]
    return Blocks(
        method="blockgaussian",
        labels=partition_density.owner_rectangle(found, ground_positions),
        views=_covering(place, held),
    )


def vastgaussian_blocks(place: Ground, blocks: int) -> Blocks:
    """VastGaussian's cells over the training cameras, with its visibility-based selection."""
    cameras = tuple(view.camera for view in place.scene.train_views)
    centres = torch.stack([camera.centre for camera in cameras]) @ place.frame.T
    grid = partition_cameras.camera_grid(centres[:, :2], *near_square(blocks))
    views = []
    for block in range(blocks):
        found = partition_cameras.select(
            grid, block, place.frame, cameras, place.scene.points.positions
        )
        views.append(torch.zeros_like(place.trained).masked_scatter(place.trained, found.views))
    return Blocks(
        method="vastgaussian",
        labels=partition_cameras.owner_cell(grid, place.positions[:, :2]),
        views=tuple(views),
    )


def citygaussian_blocks(place: Ground, blocks: int, backend: str) -> Blocks:
    """CityGaussian's uniform grid in contracted space, views by the change of a coarse model.

    The coarse model is one Gaussian a sparse point, not a trained one; so cells are not grown to
    hold the 25,000 of a trained model's millions, which may be half of all there are here.
    """
    foreground = partition_grid.central_box(place.positions)
    cells = (*near_square(blocks), 1)
    unit = partition_grid.contract(place.positions, foreground)
    views = place.scene.views
    centres = torch.stack([view.camera.centre for view in views]) @ place.frame.T
    inside = partition_grid.contract(centres, foreground)
    change = coarse_change(place, backend)
    chosen = []
    for cell in range(blocks):
        grown = partition_grid.grown_cell(unit, cells, cell, enough=0)
        chosen.append(
            place.trained
            & partition_grid.needed_views(
                inside, cells, cell, lambda v, held=grown: change(v, held), threshold=CHANGE
            )
        )
    return Blocks(
        method="citygaussian", labels=partition_grid.cell_of(unit, cells), views=tuple(chosen)
    )


def coarse_change(place: Ground, backend: str) -> Callable[[int, Bool[Tensor, " n"]], float]:
    """1 - SSIM of a view's image of one Gaussian a point, with and without some of the points.

    0 for views that are not trained on, so that they cost nothing.

    Source: CityGaussian, Sec. 3.2, Eq. 4.
    """
    rasterize = get_backend(backend).rasterize
    model = from_points(place.scene, degree=0, opacity=COARSE_OPACITY)
    parts = (model.means, model.unit_quaternions, model.scales, model.opacities)

    def image(view: int, kept: Bool[Tensor, " n"]) -> Tensor:
        camera = narrowed(place.scene.views[view].camera, COARSE_WIDTH)
        return rasterize(camera, *(part[kept] for part in parts), sh=model.sh[kept]).colour

    everything = torch.ones(len(model), dtype=torch.bool)
    whole: dict[int, Tensor] = {}

    def change(view: int, without: Bool[Tensor, " n"]) -> float:
        if not bool(place.trained[view]) or not bool(without.any()):
            return 0.0
        if view not in whole:
            whole[view] = image(view, everything).clamp(0, 1)
        return 1 - ssim_3dgs(image(view, ~without).clamp(0, 1), whole[view])

    return change


def narrowed(camera: Camera, width: int) -> Camera:
    """The camera with an image at most `width` wide."""
    if camera.width <= width:
        return camera
    size = (width, max(1, round(camera.height * width / camera.width)))
    K = scale_intrinsics(camera.K, (camera.width, camera.height), size)
    return replace(camera, K=K, width=size[0], height=size[1])


def partitions(place: Ground, blocks: int, backend: str = "cpu") -> Iterator[Blocks]:
    """All partitions of a scene into K blocks, one after the other.

    "odbp" asks for loads within 1 % of the mean and takes the best of ten METIS seeds; "odbp_paper"
    is DPGS' own setting, 5 %, with one seed.
    """
    yield odbp_blocks(place, blocks, "odbp", imbalance=0.01, seeds=10)
    yield odbp_blocks(place, blocks, "odbp_paper", imbalance=0.05, seeds=1)
    yield blockgaussian_blocks(place, blocks)
    yield vastgaussian_blocks(place, blocks)
    yield citygaussian_blocks(place, blocks, backend)


def partition_row(place: Ground, found: Blocks, blocks: int) -> dict[str, Any]:
    """Figures of one partition.

    Load is the summed track length of a block's points. The cut is counted for all partitions on
    one graph, the plain voxel grid: a voxel belongs to the block that has most of its load, by
    points where nobody saw any. Empty blocks count with load 0 and no views.
    """
    load = torch.bincount(found.labels, weights=place.loads.double(), minlength=blocks)
    mean = load.mean()
    views = torch.tensor([int(chosen.sum()) for chosen in found.views]).double()
    grid = grid_coordinates(place.positions.numpy(), place.voxel_size)
    graph = voxel_graph(grid, place.loads.numpy(), np.zeros(len(grid), dtype=np.int64))
    share = np.zeros((len(graph.weights), blocks))
    np.add.at(share, (graph.voxel_of_point, found.labels.numpy()), place.loads.numpy() + 1e-9)
    return {
        "scene": place.scene.name,
        "k": blocks,
        "method": found.method,
        "load_std_over_mean": float(load.std(correction=0) / mean) if mean > 0 else 0.0,
        "load_max_over_mean": float(load.max() / mean) if mean > 0 else 0.0,
        "edge_cut": cut_size(graph.all_edges, share.argmax(axis=1)),
        "views_mean": float(views.mean()),
        "views_max": int(views.max()),
        "note": found.note,
    }


def partition_rows(
    scene: Scene, ks: tuple[int, ...], *, voxel_size: float | None = None, backend: str = "cpu"
) -> list[dict[str, Any]]:
    """Compare the partitions of a scene: a row for each number of blocks and method.

    Args:
        scene: With training views and sparse points with tracks.
        ks: Numbers of blocks, each at least 1.
        voxel_size: Side of ODBP's voxels in scene units; None: 64 along the scene.
        backend: Rasterizer for CityGaussian's view rule.

    Returns: Rows with scene, k, method, load_std_over_mean, load_max_over_mean, edge_cut,
        views_mean, views_max and note.

    Raises: UsageError for a number of blocks below 1; DataError for more blocks than the scene has
        cameras or distinct points, or for a scene without training views or points.
    """
    if any(k < 1 for k in ks):
        raise UsageError(f"numbers of blocks {ks}: expected each at least 1")
    place = ground(scene, voxel_size)
    return [partition_row(place, found, k) for k in ks for found in partitions(place, k, backend)]


def _covering(place: Ground, held: list[Bool[Tensor, " n"]]) -> tuple[Bool[Tensor, " v"], ...]:
    """Training views that cover the points of each block by either of the two shares."""
    return tuple(
        place.trained
        & covering_views(
            place.scene.points, points, len(place.scene.views),
            view_share=VIEW_SHARE, block_share=BLOCK_SHARE,
        )
        for points in held
    )  # fmt: skip


def _note(found: OdbpPartition) -> str:
    """What to say of a partition whose loads miss the bound."""
    if found.balanced:
        return ""
    return f"loads differ from the mean by up to {found.worst:.1%}; the bound could not be met"
