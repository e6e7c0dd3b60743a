"""Fewer points to start from: those of one voxel become one."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.reference.types.cells import unique_rows
from splatproof.reference.types.scene import Scene, SparsePoints

HALVINGS = 30
"""Halvings of the interval in which the voxels' edge is looked for."""


def with_at_most(scene: Scene, most: int) -> Scene:
    """The scene with at most so many points; each is the mean of those in its voxel, in place and colour.

    Voxels are the smallest cubes, with a corner at the points' own, that leave no more. A merged point
    is seen by whoever saw one of its points. Where many points lie close together, as where many photos
    overlap, most are merged; lone ones stay.

    Args:
        scene: With any number of points; one with few enough is returned as it is.
        most: Number of points, >= 1.

    Source: ours.
    """
    points = scene.points
    if len(points) <= most:
        return scene
    positions = points.positions.double()
    corner = positions.amin(dim=0)
    size = float((positions.amax(dim=0) - corner).max()) or 1.0  # all in one place
    low, high = size * 2.0**-HALVINGS, 2 * size
    for _ in range(HALVINGS):
        middle = (low * high) ** 0.5
        if len(unique_rows(_cells(positions, corner, middle))[0]) > most:
            low = middle
        else:
            high = middle
    return replace(scene, points=_merged(points, unique_rows(_cells(positions, corner, high))[1]))


def _cells(
    positions: Float[Tensor, "n 3"], corner: Float[Tensor, "3"], edge: float
) -> Int[Tensor, "n 3"]:
    return ((positions - corner) / edge).floor().long()


def _merged(points: SparsePoints, owner: Int[Tensor, " n"]) -> SparsePoints:
    """One point a cell, in the order of the cells."""
    count = int(owner.max()) + 1
    members = torch.bincount(owner, minlength=count)[:, None]
    places, colours = (
        values.new_zeros(count, 3, dtype=torch.float64).index_add_(0, owner, values.double())
        / members
        for values in (points.positions, points.colours)
    )
    pairs = torch.stack(
        [owner.repeat_interleave(points.track_starts.diff()), points.track_views], dim=1
    )
    pairs = unique_rows(pairs)[0]
    counts = torch.bincount(pairs[:, 0], minlength=count)
    return SparsePoints(
        positions=places,
        colours=colours.round().clamp(0, 255).byte(),
        track_starts=torch.cat([counts.new_zeros(1), counts.cumsum(0)]),
        track_views=pairs[:, 1],
    )
