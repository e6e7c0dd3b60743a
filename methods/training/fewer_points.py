"""Fewer points to start from: those of one voxel become one."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float64

from splatproof.methods.training.dense_points import ordered, summed
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
    positions = points.positions.double().numpy()
    corner = positions.min(axis=0)
    size = float((positions.max(axis=0) - corner).max()) or 1.0  # all in one place
    low, high = size * 2.0**-HALVINGS, 2 * size
    for _ in range(HALVINGS):
        middle = (low * high) ** 0.5
        if len(np.unique(_cells(positions, corner, middle), axis=0)) > most:
            low = middle
        else:
            high = middle
    return replace(scene, points=_merged(points, _cells(positions, corner, high)))


def _cells(
    positions: Float64[np.ndarray, "n 3"], corner: Float64[np.ndarray, "3"], edge: float
) -> np.ndarray:
    return np.floor((positions - corner) / edge).astype(np.int64)


def _merged(points: SparsePoints, cells: np.ndarray) -> SparsePoints:
    """One point a cell, in the order of the cells."""
    ones = np.ones((len(cells), 1))
    rows = np.hstack([points.positions.double().numpy(), points.colours.double().numpy(), ones])
    keys, sums = summed(cells, rows)
    means = sums[:, :6] / sums[:, 6:]
    owner = np.searchsorted(ordered(keys), ordered(cells))
    lengths = points.track_starts.diff().numpy()
    pairs = np.stack([np.repeat(owner, lengths), points.track_views.numpy()], axis=1)
    pairs = np.unique(pairs, axis=0)
    counts = np.bincount(pairs[:, 0], minlength=len(keys))
    return SparsePoints(
        positions=torch.from_numpy(means[:, :3]),
        colours=torch.from_numpy(means[:, 3:].round().clip(0, 255).astype(np.uint8)),
        track_starts=torch.from_numpy(np.concatenate([[0], counts.cumsum()])),
        track_views=torch.from_numpy(pairs[:, 1]),
    )
