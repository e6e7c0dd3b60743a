"""CityGaussian's partition: a uniform grid in contracted space, views by what they lose."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.partition.boxes import Box

GROWTH = 0.01
"""Step in contracted units by which a cell grows until it holds enough Gaussians."""
ENOUGH = 25_000
"""A cell is grown until it holds this many Gaussians, or all there are."""


def contract(points: Float[Tensor, "n 3"], box: Box) -> Float[Tensor, "n 3"]:
    """Map all of space to (0, 1)^3, the box to [1/4, 3/4]^3.

    With u in [-1, 1]^3 inside the box and m = |u|_inf: u' = u where m <= 1, else (2 - 1/m) u / m;
    the result is u' / 4 + 1/2.

    Args:
        points: Positions in the box's frame.
        box: The foreground, of positive size on each axis.

    Raises: DataError for a box without volume.

    Source: CityGaussian, Sec. 3.2 (contraction of Mip-NeRF 360 with the max-norm).
    """
    u = (2 * points - (box.low + box.high).to(points)) / _size(box).to(points)
    norm = u.abs().amax(dim=1, keepdim=True)
    outside = norm.clamp(min=1)
    return torch.where(norm <= 1, u, (2 - 1 / outside) * (u / outside)) / 4 + 0.5


def expand(unit: Float[Tensor, "n 3"], box: Box) -> Float[Tensor, "n 3"]:
    """Inverse of contract: positions of points in (0, 1)^3.

    Args:
        unit: Contracted positions in (0, 1)^3; the border of the cube stands for infinity.
        box: The foreground that `contract` was given.
    """
    v = 4 * unit - 2
    norm = v.abs().amax(dim=1, keepdim=True)
    outside = norm.clamp(min=1)
    u = torch.where(norm <= 1, v, v / (outside * (2 - outside)))
    return (u * _size(box).to(unit) + (box.low + box.high).to(unit)) / 2


def central_box(points: Float[Tensor, "n 3"]) -> Box:
    """Box around the median, as far as the median distance from it on each axis.

    Published runs give the box by hand; the release's fallback (focus of the optical axes) is
    undetermined for nadir flights, whose axes are nearly parallel. An axis without any spread gets
    the width of the widest one.

    Raises: DataError without points, or where all coincide.

    Source: ours, after CityGaussian's release (median distance per axis).
    """
    if len(points) == 0:
        raise DataError("a box around no points: expected at least one point")
    middle = points.median(dim=0).values
    half = (points - middle).abs().median(dim=0).values
    if not bool((half > 0).any()):
        half = (points - middle).abs().amax(dim=0)
    if not bool((half > 0).any()):
        raise DataError("all points coincide: expected points that span a scene")
    half = torch.where(half > 0, half, half.max())
    return Box(low=middle - half, high=middle + half)


def cell_of(unit: Float[Tensor, "n 3"], cells: tuple[int, int, int]) -> Int64[Tensor, " n"]:
    """Cell z XY + y X + x of each point of the unit cube; each point is in exactly one.

    Cells are half-open; a coordinate of 1 (where contraction rounds up) belongs to the last cell.
    This is the merge rule too: block k keeps the Gaussians whose means are in cell k.

    Args:
        unit: Contracted positions in [0, 1]^3.
        cells: Number of cells (X, Y, Z).
    """
    count = torch.tensor(cells)
    index = (unit.double() * count).floor().long().clamp(min=0).minimum(count - 1)
    return (index[:, 2] * cells[1] + index[:, 1]) * cells[0] + index[:, 0]


def strictly_inside(
    unit: Float[Tensor, "n 3"], cells: tuple[int, int, int], cell: int
) -> Bool[Tensor, " n"]:
    """Which contracted positions lie inside the cell and on none of its walls.

    Args:
        unit: Contracted positions in [0, 1]^3.
        cells: Number of cells (X, Y, Z).
        cell: Number of the cell, z XY + y X + x.
    """
    low, high = _walls(cells, cell)
    return ((unit > low) & (unit < high)).all(dim=1)


def grown_cell(
    unit: Float[Tensor, "n 3"], cells: tuple[int, int, int], cell: int, *, enough: int = ENOUGH
) -> Bool[Tensor, " n"]:
    """Gaussians in the cell, widened by 0.01 a side until it holds `enough` of them, or all.

    The release grows forever in scenes with fewer Gaussians than that.

    Args:
        unit: Contracted positions of the Gaussians' means in [0, 1]^3.
        cells: Number of cells (X, Y, Z).
        cell: Number of the cell, z XY + y X + x.
        enough: Number of Gaussians that ends the growth.

    Source: CityGaussian's release (block_filtering).
    """
    low, high = _walls(cells, cell)
    enough = min(enough, len(unit))
    steps = 0
    while True:
        rim = steps * GROWTH
        held = ((unit >= low - rim) & (unit <= high + rim)).all(dim=1)
        if int(held.sum()) >= enough:
            return held
        steps += 1


def needed_views(
    centres: Float[Tensor, "v 3"],
    cells: tuple[int, int, int],
    cell: int,
    change: Callable[[int], float],
    *,
    threshold: float,
) -> Bool[Tensor, " v"]:
    """Views whose camera is strictly inside the cell, or whose image changes without the block.

    Args:
        centres: Contracted camera centres.
        cells: Number of cells (X, Y, Z).
        cell: Number of the block's cell, z XY + y X + x.
        change: Takes the index of a view and returns 1 - SSIM between the coarse model's image of
            it and the one without the Gaussians of the grown cell; asked only for cameras outside
            the cell.
        threshold: epsilon; 0.05 to 0.12 in the published runs.

    Source: CityGaussian, Sec. 3.2, Eq. 4.
    """
    within = strictly_inside(centres, cells, cell).tolist()
    return torch.tensor([w or change(v) > threshold for v, w in enumerate(within)]).bool()


def _walls(cells: tuple[int, int, int], cell: int) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Lower and upper walls of a cell in contracted units."""
    count = torch.tensor(cells)
    index = torch.tensor(
        [cell % cells[0], cell // cells[0] % cells[1], cell // cells[0] // cells[1]]
    )
    return index.double() / count, (index + 1).double() / count


def _size(box: Box) -> Float[Tensor, "3"]:
    """Lengths of the box's axes, all positive."""
    size = box.high - box.low
    if not bool((size > 0).all()):
        raise DataError(f"foreground box of size {size.tolist()}: expected three positive lengths")
    return size
