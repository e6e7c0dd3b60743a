"""HDGS control of anchors: growth by gradient and density, growth in time, unvisited records."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.types.cells import unique_rows


@dataclass(frozen=True, kw_only=True)
class GrowthSettings:
    """Thresholds of growth and pruning. The paper gives no values: these are ours."""

    gradient: float = 2e-4
    """Mean 2D gradient of a voxel's Gaussians from which it grows."""
    density: float = 5.0
    """Number of Gaussians in a voxel from which it is subdivided finely."""
    temporal_gradient: float = 2e-3
    """Mean |d loss / d tau| of a voxel from which it may grow in time."""
    temporal_share: float = 0.25
    """Share of the voxels above temporal_gradient that do grow in time, drawn at random."""
    fine: int = 2
    """Number of parts into which the edge of a dense voxel is cut."""
    opacity: float = 0.005
    """Mean opacity of an anchor's Gaussians below which it is pruned."""
    unvisited: int = 500
    """Steps outside every view after which an anchor is pruned; `keep` raises it to two passes over
    the training views where that is longer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelStatistics:
    """What is known of each occupied voxel after N_g iterations."""

    cells: Int[Tensor, "v 3"]
    owner: Int[Tensor, " m"]
    """Row of `cells` of each Gaussian."""
    density: Float[Tensor, " v"]
    """Number of Gaussians in the voxel."""
    gradient: Float[Tensor, " v"]
    """Mean, over the voxel's Gaussians, of their mean 2D gradients."""


def voxel_statistics(
    positions: Float[Tensor, "m 3"], gradients: Float[Tensor, " m"], voxel: float
) -> VoxelStatistics:
    """Local density and average gradient of the neural Gaussians of each voxel.

    Args:
        positions: Means of the neural Gaussians in scene units.
        gradients: Mean 2D gradient of each Gaussian over the N_g iterations.
        voxel: Edge of a voxel in scene units, > 0.

    Source: HDGS, Sec. 3.5, "Growing".
    """
    cells, owner = unique_rows((positions / voxel).floor().long())
    zero = gradients.new_zeros(len(cells))
    density = zero.index_add(0, owner, torch.ones_like(gradients))
    total = zero.index_add(0, owner, gradients)
    return VoxelStatistics(
        cells=cells, owner=owner, density=density, gradient=total / density.clamp(min=1)
    )


def new_anchors(
    anchors: Float[Tensor, "n 3"],
    positions: Float[Tensor, "m 3"],
    statistics: VoxelStatistics,
    voxel: float,
    settings: GrowthSettings,
) -> Float[Tensor, "a 3"]:
    """Centres of new anchors: none where the gradient is low, fine ones where it is dense too.

    High gradient and high density: a centre in every sub-cell (fine x fine x fine) that holds a
    Gaussian. High gradient, low density: one centre for the whole voxel. A cell of either kind
    that holds an anchor already gets none (ours), so that anchors which stood in distinct sub-cells
    still do: the support network's grid must then have the sub-cells' edge, voxel / fine.

    Args:
        anchors: Centres of the anchors so far, scene units.
        positions: Means of the neural Gaussians in scene units.
        statistics: From `voxel_statistics` with the same positions and voxel.
        voxel: Edge of a voxel in scene units, > 0.
        settings: Thresholds of gradient and density, and the subdivision of dense voxels.

    Returns: Positions in scene units: first those of whole voxels, then those of sub-cells.

    Source: HDGS, Sec. 3.5 (GDG).
    """
    steep = statistics.gradient >= settings.gradient
    dense = statistics.density >= settings.density
    coarse = _free(statistics.cells[steep & ~dense], anchors, voxel)
    inside = (steep & dense)[statistics.owner]
    edge = voxel / settings.fine
    parts = unique_rows((positions[inside] / edge).floor().long())[0]
    fine = _free(parts, anchors, edge)
    return torch.cat([(coarse.to(positions) + 0.5) * voxel, (fine.to(positions) + 0.5) * edge])


def _free(
    cells: Int[Tensor, "c 3"], anchors: Float[Tensor, "n 3"], edge: float
) -> Int[Tensor, "d 3"]:
    """The cells of this edge in which no anchor stands."""
    taken = {tuple(cell) for cell in (anchors / edge).floor().long().tolist()}
    free = [tuple(cell) not in taken for cell in cells.tolist()]
    return cells[torch.tensor(free, dtype=torch.bool)]


def temporal_growth(
    gradient: Float[Tensor, " v"], settings: GrowthSettings, generator: torch.Generator
) -> Bool[Tensor, " v"]:
    """Voxels that grow in time: a random share of those with a high temporal gradient.

    Args:
        gradient: Mean |d loss / d tau| of each voxel, >= 0.
        settings: Gradient from which a voxel may grow in time, and the share that does.
        generator: Source of the random share.

    Source: HDGS, Sec. 3.5.
    """
    drawn = torch.rand(len(gradient), generator=generator) < settings.temporal_share
    return (gradient >= settings.temporal_gradient) & drawn


def update_unvisited(record: Int[Tensor, " n"], visible: Bool[Tensor, " n"]) -> Int[Tensor, " n"]:
    """The unvisited record (UR): iterations since each anchor was last in a view.

    Args:
        record: Iterations since each anchor was last in a view, up to the iteration before.
        visible: Which anchors are in the view of this iteration.

    Source: HDGS, Sec. 3.5, "Pruning".
    """
    return torch.where(visible, 0, record + 1)


def keep(
    opacity: Float[Tensor, " n"],
    record: Int[Tensor, " n"],
    views: int,
    settings: GrowthSettings,
) -> Bool[Tensor, " n"]:
    """Anchors that stay: opaque enough over N_p iterations, and visited recently enough.

    Each pass draws every training view once in a new order, so an anchor that a single one sees
    may wait for nearly two passes: with a shorter limit the draw alone would prune it (ours).

    Args:
        opacity: Mean opacity of each anchor's Gaussians over the N_p iterations in which it was
            visible; nan for an anchor that never was (only its record counts).
        record: Iterations since each anchor was last in a view, from `update_unvisited`.
        views: Number of training views, > 0.
        settings: Least opacity, and the longest time out of view.

    Source: HDGS, Sec. 3.5, "Pruning".
    """
    faint = opacity < settings.opacity  # nan compares as false
    return ~faint & (record <= max(settings.unvisited, 2 * views))
