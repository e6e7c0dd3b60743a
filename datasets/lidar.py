"""LiDAR sweeps as a bounded number of sparse points."""

from collections.abc import Sequence

import numpy as np

from splatproof.datasets.layout import Sweep, plain_points
from splatproof.reference.types.scene import SparsePoints

MOST_POINTS = 600_000
"""Points that a scene takes from its sweeps (Chen et al. 2023, PVG, release: num_pts)."""
GREY = 128
"""SRGB of a point: LiDAR sees no colour."""


def sample_sweeps(sweeps: Sequence[Sweep], most: int = MOST_POINTS) -> SparsePoints:
    """An equal share of points from each sweep, without replacement; one sweep is held at a time.

    The draw depends on the number of sweeps and each one's place alone (seed: its index).
    PVG draws from all sweeps at once, with replacement, after reading all; equal shares: ours.

    Args:
        sweeps: All sweeps of a scene that may be used, in order of time.
        most: Bound on the number of points.
    """
    share = -(-most // max(len(sweeps), 1))
    kept = []
    for index, sweep in enumerate(sweeps):
        points = sweep.read()
        if len(points) > share:
            chosen = np.random.default_rng(index).choice(len(points), share, replace=False)
            points = points[np.sort(chosen)]
        kept.append(points)
    positions = np.concatenate([np.zeros((0, 3)), *kept])[:most]
    return plain_points(positions, np.full((len(positions), 3), GREY, np.uint8))
