"""Layer 0 from what LiDAR and photos measured: where anchors stand, when they peak, how long they live."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.dynamic.sweep_points import TimedPoints
from splatproof.methods.training.initialise import neighbour_distance
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings
from splatproof.reference.types.cells import unique_rows

SPREAD = 0.3
"""Deviation of the offsets at the start, in units of an anchor's scale: siblings start apart."""
INSIDE = 0.49
"""Largest distance of an anchor from its voxel's middle, in edges."""
INSTANCE = 0.1
"""Deviation of instance features at the start."""
HALVINGS = 20
"""Steps of the search for a voxel's edge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sites:
    """Where and when anchors start, one in each voxel."""

    centres: Float[Tensor, "n 3"]
    colours: Float[Tensor, "n 3"]
    """Mean colour of the points in each, in [0, 1]."""
    times: Float[Tensor, " n"]
    """Peaks."""
    velocities: Float[Tensor, "n 3"]
    """Mean velocity of the points in each."""
    moves: Bool[Tensor, " n"]
    """Whether points in it were seen to move."""


def sites(points: TimedPoints, voxel: float, middle: float) -> Sites:
    """One anchor in each voxel that holds a point of what stands still; what moves has finer voxels.

    What stands still peaks in the middle of the drive. A finer voxel that something moved through
    belongs to one of the moments at which a point was measured in it.

    Args:
        points: In the units of voxel, peaks and velocities, in any order: the first moving one of a
            voxel decides on its moment.
        voxel: Edge of the voxels; the finer ones are half as wide.
        middle: Peak of what stands still.
    """
    fine = cells_of(points.positions, voxel / 2)
    kinds, which = unique_rows(fine)
    (moving,) = torch.where(points.moved)
    order = torch.full((len(kinds),), len(points)).scatter_reduce_(0, which[moving], moving, "amin")
    owner = order[which]
    claimed = owner < len(points)
    mine = points.moved & claimed
    mine &= points.seconds == points.seconds[owner.clamp(max=len(points) - 1)]
    there, passing = _means(points.take(mine), voxel / 2)
    here, standing = _means(points.take(~points.moved & ~claimed), voxel)
    # An anchor that stands, put at the mean of its points, may be in a voxel of one that moves.
    free = free_of(cells_of(here, voxel / 2), cells_of(there, voxel / 2))
    rest = torch.full((int(free.sum()),), middle, dtype=torch.float64)
    return Sites(
        centres=torch.cat([here[free], there]),
        colours=torch.cat([standing[free, :3], passing[:, :3]]),
        times=torch.cat([rest, passing[:, 6]]),
        velocities=torch.cat([torch.zeros_like(here[free]), passing[:, 3:6]]),
        moves=torch.arange(len(rest) + len(there)) >= len(rest),
    )


def cells_of(positions: Float[Tensor, "m 3"], edge: float) -> Int[Tensor, "m 3"]:
    """Voxel of each position.

    Args:
        positions: In one unit with the edge.
        edge: Edge of a voxel.
    """
    return (positions / edge).floor().long()


def free_of(cells: Int[Tensor, "m 3"], taken: Int[Tensor, "n 3"]) -> Bool[Tensor, " m"]:
    """Which cells are not taken.

    Args:
        cells: Those asked about.
        taken: Cells that are.
    """
    kinds, which = unique_rows(torch.cat([taken, cells]))
    held = torch.zeros(len(kinds), dtype=torch.bool, device=cells.device)
    held[which[: len(taken)]] = True
    return ~held[which[len(taken) :]]


def _means(points: TimedPoints, edge: float) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 7"]]:
    """Mean place of each voxel's points, well inside of it, and their mean colour, velocity, time."""
    cells, which = unique_rows(cells_of(points.positions, edge))
    count = torch.bincount(which, minlength=len(cells)).double()[:, None]
    middle = (cells + 0.5) * edge
    told = [points.colours / 255, points.velocities, points.seconds[:, None]]
    # Places are summed about the voxel's middle: coordinates may be large.
    values = torch.cat([points.positions - middle[which], *told], dim=1).double()
    sums = values.new_zeros(len(cells), values.shape[1]).index_add_(0, which, values)
    off, rest = (sums / count).split([3, 7], dim=1)
    return middle + off.clamp(-INSIDE * edge, INSIDE * edge), rest


def voxel_for(positions: Float[Tensor, "m 3"], anchors: int) -> float:
    """Smallest edge, up to two per cent, of voxels of which at most so many hold a point.

    Args:
        positions: Points.
        anchors: Most voxels that may hold a point; at least 1.
    """
    size = float((positions.amax(dim=0) - positions.amin(dim=0)).max()) or 1.0
    low, high = -float(HALVINGS), 1.0  # powers of 2 of the size
    while high - low > 0.03:
        power = (low + high) / 2
        held = unique_rows(cells_of(positions, size * 2**power))[0]
        low, high = (power, high) if len(held) > anchors else (low, power)
    return size * 2**high


def started(
    at: Sites,
    sizes: HierarchySettings,
    *,
    spans: Float[Tensor, " n"],
    lone: float,
    shared: dict[str, Tensor],
    generator: torch.Generator,
) -> Parameters:
    """Anchors at their start: scales by neighbours of the same moment, features that hold colours.

    Args:
        at: Where and when.
        sizes: Sizes of the hierarchy.
        spans: Life spans beta, in the unit of the times.
        lone: Scale of an anchor without neighbours.
        shared: Tensors of networks and sky.
        generator: Draws offsets and instance features.
    """
    count = len(at.centres)
    features = torch.zeros(count, sizes.features)
    shown = min(3, sizes.features)
    features[:, :shown] = at.colours[:, :shown].float() - 0.5
    apart = torch.zeros(count, dtype=torch.float64)
    for group in by_moment(at):
        apart[group] = neighbour_distance(at.centres[group], lone=lone)
    return Parameters(
        {
            "features": features,
            "instances": INSTANCE * torch.randn(count, sizes.instance, generator=generator),
            "quaternions": torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
            "log_scales": apart.log().float()[:, None].repeat(1, 3),
            "peaks": at.times.float(),
            "velocities": at.velocities.float(),
            "log_spans": spans.log().float(),
            **drawn_offsets(sizes, count, generator),
        },
        shared=shared,
        labels={"centres": at.centres.float()},
    )


def by_moment(at: Sites) -> Iterator[Int[Tensor, " g"]]:
    """Rows of what stands still, then of what moves, moment by moment."""
    (standing,) = torch.where(~at.moves)
    if len(standing):
        yield standing
    for time in at.times[at.moves].unique():
        yield torch.where(at.moves & (at.times == time))[0]


def drawn_offsets(
    sizes: HierarchySettings, count: int, generator: torch.Generator
) -> dict[str, Tensor]:
    """Offsets of anchors at their start, by tensor: siblings at one place would stay there together.

    Args:
        sizes: Sizes of the hierarchy.
        count: Number of anchors.
        generator: Source of the draw.
    """
    children = [sizes.children**layer for layer in range(1, sizes.layers - 1)]
    return {
        f"offsets{layer}": SPREAD * torch.randn(count, number, 3, generator=generator)
        for layer, number in enumerate([*children, sizes.gaussians], start=1)
    }
