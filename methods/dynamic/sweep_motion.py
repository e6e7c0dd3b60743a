"""How fast what sweeps found to be moving moves: groups of returns, found again in the next sweep."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int32
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.methods.dynamic.sweep_points import TimedPoints

JOINED = 3.0
"""Spacings of returns within which two are of one thing."""
LEAST_RETURNS = 3
"""Returns that a thing needs to be found again."""
REACH = 1.5
"""Diameters of a thing that it moves at most between two sweeps."""
SAMPLES = 48
"""Returns of a thing that are looked for again."""
MOST = 256
"""Returns of a thing, and of what is near it, among which its shift is searched for: what a search costs grows with
their product, and a car nearby has thousands."""
SHIFTS = 256
"""Shifts, those that bring a thing best onto what is near it, of which it is asked what they leave uncovered."""
BACK = 0.7
"""A thing is taken to move where that leaves less than this share of the distance between returns that
standing still leaves."""
SURE = 0.5
"""Spacings of its returns that a thing must have gone: other returns of a thing that stands still (a lamp, twigs)
look as if it had gone less. What is slow is lost far away: a walker goes 0.14 m in a tenth of a second."""


def in_motion(points: TimedPoints, up: Float[Tensor, "3"]) -> TimedPoints:
    """The points with velocities; what was looked through but is not found to move stands still.

    Twigs, and the ground where beams skip it, are looked through without moving.

    Args:
        points: Returns of all moments.
        up: Unit vector away from the ground.
    """
    found = velocities(points, up)
    return replace(points, velocities=found, moved=found.any(dim=1))


def velocities(points: TimedPoints, up: Float[Tensor, "3"]) -> Float[Tensor, "n 3"]:
    """Velocity of each return, scene units a second; 0 for what does not move or is not found again.

    Returns of one moment that lie close together are one thing, which moves as a whole; the shift
    that brings it onto returns of a neighbouring sweep, and those onto it, is its motion.

    Args:
        points: Returns of all moments; those that moved are looked at.
        up: Unit vector away from the ground, along which nothing moves more than it moves along the ground.

    Returns: Float32.

    Source: ours; the release of PVG starts from 0, which takes thousands of steps to leave.
    """
    found, away = torch.zeros(len(points), 3), up.double().numpy()
    moments = points.seconds[points.moved].unique().tolist()
    index = [torch.where(points.moved & (points.seconds == time))[0] for time in moments]
    places = [points.positions[own].numpy() for own in index]
    for now, own in enumerate(index):
        near = [other for other in (now - 1, now + 1) if 0 <= other < len(moments)]
        groups = things(places[now])
        for group in range(groups.max(initial=-1) + 1):
            members = np.flatnonzero(groups == group)
            if len(members) < LEAST_RETURNS:
                continue
            best = (BACK, np.zeros(3))
            sure = SURE * _spacing(places[now][members])
            for other in near:
                left, shift = motion(places[now][members], places[other], away)
                if left < best[0] and np.linalg.norm(shift) > sure:
                    best = (left, shift / (moments[other] - moments[now]))
            found[own[members]] = torch.from_numpy(best[1]).float()
    return found


def things(positions: Float64[np.ndarray, "n 3"]) -> Int32[np.ndarray, " n"]:
    """Number of the thing that each return of a moment belongs to.

    Args:
        positions: Returns of one moment.
    """
    if len(positions) < 2:
        return np.zeros(len(positions), np.int32)
    pairs = KDTree(positions).sparse_distance_matrix(
        KDTree(positions), JOINED * _spacing(positions) + 1e-9, output_type="coo_matrix"
    )
    return connected_components(pairs, directed=False)[1]


def _spacing(positions: Float64[np.ndarray, "n 3"]) -> float:
    """Median distance of the third neighbour, or the last where there are fewer."""
    apart, _ = KDTree(positions).query(positions, k=min(4, len(positions)))
    return float(np.median(np.reshape(apart, (len(positions), -1))[:, -1]))


def motion(
    thing: Float64[np.ndarray, "n 3"],
    others: Float64[np.ndarray, "m 3"],
    up: Float64[np.ndarray, "3"],
) -> tuple[float, Float64[np.ndarray, "3"]]:
    """Shift that brings a thing onto the returns of another moment, along the ground more than up or down.

    It is searched for among `MOST` returns and brought to rest among all.

    Args:
        thing: Returns of one thing, at least LEAST_RETURNS.
        others: Returns of the other moment.
        up: Unit vector away from the ground. A post may be shifted along itself and still lie on itself.

    Returns: Distance that is left, as a share of what standing still leaves (inf where nothing is in
        reach); the shift in scene units.
    """
    centre = thing.mean(axis=0)
    size = 2 * np.linalg.norm(thing - centre, axis=1).max()
    close = others[np.linalg.norm(others - centre, axis=1) < (REACH + 0.5) * size]
    if not len(close):
        return np.inf, np.zeros(3)
    few = _spread(thing, MOST)
    spacing = _spacing(few)
    far = 2 * spacing
    sample = _spread(thing, SAMPLES)

    def onto(
        shifts: Float64[np.ndarray, "s 3"], close: Float64[np.ndarray, "b 3"]
    ) -> Float64[np.ndarray, " s"]:
        apart = KDTree(close).query(sample + shifts[:, None], distance_upper_bound=far)[0]
        return np.minimum(apart, far).mean(axis=1)

    def back(
        shifts: Float64[np.ndarray, "s 3"],
        thing: Float64[np.ndarray, "a 3"],
        close: Float64[np.ndarray, "b 3"],
    ) -> Float64[np.ndarray, " s"]:
        moved = close - shifts[:, None]
        of, part = np.nonzero(np.linalg.norm(moved - centre, axis=2) < size)
        apart = KDTree(thing).query(moved[of, part], distance_upper_bound=far)[0]
        count = np.bincount(of, minlength=len(shifts))
        total = np.bincount(of, np.minimum(apart, far), minlength=len(shifts))
        return np.where(count > 0, total / np.maximum(count, 1), far)

    def left(shifts: Float64[np.ndarray, "s 3"]) -> Float64[np.ndarray, " s"]:
        return onto(shifts, close) + back(shifts, thing, close)

    near = _spread(close, MOST)
    shifts = (near[None] - sample[:, None]).reshape(-1, 3)
    shifts = shifts[_level(shifts, up) & (np.linalg.norm(shifts, axis=1) < REACH * size)]
    if not len(shifts):
        return np.inf, np.zeros(3)
    shifts = np.unique(np.round(shifts / spacing), axis=0) * spacing
    there = onto(shifts, near)
    kept = np.argsort(there, kind="stable")[:SHIFTS]
    shift = shifts[kept][int(np.argmin(there[kept] + back(shifts[kept], few, near)))]
    tree = KDTree(close)
    for _ in range(3):  # from the grid of shifts to the best one nearby
        apart, which = tree.query(sample + shift, distance_upper_bound=far)
        met = np.isfinite(apart)
        if met.any():
            moved = shift + np.median(close[np.asarray(which)[met]] - sample[met] - shift, axis=0)
            if _level(moved[None], up)[0]:
                shift = min((shift, moved), key=lambda one: float(left(one[None])[0]))
    moving, still = left(np.stack([shift, np.zeros(3)]))
    return float(moving / max(still, 1e-12)), shift


def _level(
    shifts: Float64[np.ndarray, "s 3"], up: Float64[np.ndarray, "3"]
) -> Bool[np.ndarray, " s"]:
    """Whether shifts go along the ground more than up or down."""
    rise = shifts @ up
    return np.abs(rise) <= np.linalg.norm(shifts - rise[:, None] * up, axis=1)


def _spread(places: Float64[np.ndarray, "n 3"], most: int) -> Float64[np.ndarray, "m 3"]:
    """At most so many of the places, evenly by their order: that of the beams."""
    return places[np.linspace(0, len(places) - 1, min(most, len(places))).astype(int)]
