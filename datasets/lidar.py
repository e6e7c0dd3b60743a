"""LiDAR sweeps: which one belongs to a view, and a bounded number of sparse points from all."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float64

from splatproof.datasets.layout import SweepFile, plain_points
from splatproof.reference.types.scene import SparsePoints, Sweep

MOST_POINTS = 600_000
"""Points that a scene takes from its sweeps (Chen et al. 2023, PVG, release: num_pts)."""
SAME_MOMENT = 0.05
"""Seconds: half a frame of drives that take 10 a second. A sweep further away shows another moment."""
GREY = 128
"""SRGB of a point: LiDAR sees no colour."""


def sample_sweeps(sweeps: Sequence[SweepFile], most: int = MOST_POINTS) -> SparsePoints:
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
        points = sweep.read().positions
        if len(points) > share:
            chosen = np.random.default_rng(index).choice(len(points), share, replace=False)
            points = points[np.sort(chosen)]
        kept.append(points)
    positions = np.concatenate([np.zeros((0, 3)), *kept])[:most]
    return plain_points(positions, np.full((len(positions), 3), GREY, np.uint8))


def sweeps_of(sweeps: Sequence[SweepFile], times: Sequence[float | None]) -> list[SweepFile | None]:
    """For each view the sweep that is nearest in time, where that is at most SAME_MOMENT away.

    So where a frame's own sweep is missing its views have none, rather than that of a moment in
    which what moves was elsewhere.

    Args:
        sweeps: All sweeps of a scene; the first of two equally near ones is taken.
        times: When each view was taken, in seconds from the same start; None: unknown.
    Returns: The sweep of each view; None where there is none.
    """
    if not sweeps:
        return [None] * len(times)
    moments, found = np.array([sweep.time for sweep in sweeps]), []
    for time in times:
        gaps = np.abs(moments - (np.inf if time is None else time))
        near = int(gaps.argmin())
        found.append(sweeps[near] if gaps[near] <= SAME_MOMENT else None)
    return found


def read_sweep(file: SweepFile, shift: Float64[np.ndarray, "3"], start: float) -> Sweep:
    """A sweep as a view has it.

    Args:
        file: The sweep's file.
        shift: Vector that the scene subtracts from all positions.
        start: When the scene's first view was taken, in seconds from the start of the file's time.
    Raises: DataError naming a file that is missing or damaged.
    """
    hits = file.read()
    return Sweep(
        positions=torch.from_numpy(hits.positions - shift).float(),
        origin=torch.from_numpy(hits.origin - shift),
        time=file.time - start,
    )
