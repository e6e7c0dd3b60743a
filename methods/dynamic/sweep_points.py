"""Points from LiDAR sweeps: when they were hit, in what colour, and whether something moved there."""

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64, UInt8
from scipy.ndimage import maximum_filter1d, minimum_filter, uniform_filter
from torch import Tensor

from splatproof.methods.dynamic.terms import lidar_image
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, Sweep, View

SURFACE = 0.02
"""Share of its depth by which a return may lie behind the nearest one in its pixel and be seen."""
CELL = 0.015
"""Edge in radians of the cells that a sweep's rays are sorted into; beams are up to 0.02 apart."""
LEAST_CELLS = 3
"""Cells of the 3 x 3 around a point's direction that rays must have gone through."""
BEYOND = 0.03
"""Share of a point's distance by which all those rays must be longer to have passed it."""
VOTES = 2
"""Sweeps that must have looked through a place for what was hit there to be called moving."""
NEAREST = 24
"""Sweeps, the nearest in time, that are asked whether they looked through a place: a choice. With all
of them time would grow with the square of a drive's length, and those from far away see little of a place."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPoints:
    """Returns of sweeps that photos of the same moment show."""

    positions: Float[Tensor, "n 3"]
    """Float64, scene units, scene frame."""
    colours: UInt8[Tensor, "n 3"]
    """SRGB of the photo where each was seen."""
    seconds: Float[Tensor, " n"]
    """Float64, since the scene's first view: when the sweep was taken that hit each."""
    moved: Bool[Tensor, " n"]
    """Whether other sweeps looked through where it was."""
    velocities: Float[Tensor, "n 3"]
    """Float32, scene units a second; 0 until `sweep_motion.in_motion` looks for them."""

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.positions)

    def take(self, index: Tensor) -> "TimedPoints":
        """Some of the points.

        Args:
            index: Their numbers, or a mask.
        """
        return TimedPoints(**{name: value[index] for name, value in vars(self).items()})


def timed_points(scene: Scene, moments: Collection[float] | None = None) -> TimedPoints:
    """Returns of the training views' sweeps that a training photo of their moment shows, by time.

    A moment is a sweep with all photos that it belongs to, be they triggered one after the other.

    Args:
        scene: Its training views with a sweep and a time count; a few sweeps and one image are held at a time.
        moments: Times of sweeps whose returns are wanted; None: all.

    Source: Chen et al. 2023, "Periodic Vibration Gaussian", Sec. 4.1 (its release leaves the colours
        black); which of them moved: ours, by looking through, as in LiDAR map cleaning.
    """
    groups = _swept(scene)
    times = list(groups)

    @lru_cache(maxsize=NEAREST + 1)
    def seen_at(time: float) -> tuple[Sweep, Depths]:
        load = groups[time][0].load_sweep
        assert load is not None
        sweep = load()
        return sweep, depths(sweep, scene.up)

    found = []
    for index, time in enumerate(times):
        if moments is not None and time not in moments:
            continue
        first = max(0, min(index - NEAREST // 2, len(times) - NEAREST - 1))
        near = times[first : first + NEAREST + 1]
        sweep, _ = seen_at(time)
        colours, seen = _colours(sweep.positions, groups[time])
        positions = sweep.positions[seen].double()
        others = [seen_at(moment)[1] for moment in near if moment != time]
        found.append(
            TimedPoints(
                positions=positions,
                colours=colours[seen],
                seconds=torch.full((len(positions),), time, dtype=torch.float64),
                moved=looked_through(positions, others) >= VOTES,
                velocities=torch.zeros(len(positions), 3),
            )
        )
    return joined(found)


def swept_moments(scene: Scene) -> list[float]:
    """Times of the training views' sweeps, each once, in order.

    Args:
        scene: Its training views count.
    """
    return list(_swept(scene))


def _swept(scene: Scene) -> dict[float, list[View]]:
    """Training views with a sweep, by the time of the sweep, in order; of each those nearest to it first."""
    groups: dict[float, list[tuple[float, View]]] = defaultdict(list)
    for view in scene.train_views:
        if view.load_sweep is not None and view.time is not None:
            time = view.time if view.sweep_time is None else view.sweep_time
            groups[time].append((abs(view.time - time), view))
    return {
        time: [view for _, view in sorted(own, key=lambda one: one[0])]
        for time, own in sorted(groups.items())
    }


def joined(parts: Sequence[TimedPoints]) -> TimedPoints:
    """The points of all parts, one part after the other; no part: no points."""
    none = TimedPoints(
        positions=torch.zeros(0, 3).double(), colours=torch.zeros(0, 3).byte(),
        seconds=torch.zeros(0).double(), moved=torch.zeros(0).bool(), velocities=torch.zeros(0, 3),
    )  # fmt: skip
    names = vars(none)
    return TimedPoints(**{n: torch.cat([getattr(p, n) for p in (none, *parts)]) for n in names})


def _colours(
    positions: Float[Tensor, "n 3"], views: list[View]
) -> tuple[UInt8[Tensor, "n 3"], Bool[Tensor, " n"]]:
    """Colour of each return in the first of some photos that shows it, and whether one does."""
    colours = torch.zeros(len(positions), 3, dtype=torch.uint8)
    seen = torch.zeros(len(positions), dtype=torch.bool)
    for view in views:
        camera = view.camera
        pixels, depth = project_points(camera, positions.double())
        column, row = pixels.floor().unbind(dim=1)
        inside = (depth > camera.near) & (column >= 0) & (column < camera.width)
        inside &= (row >= 0) & (row < camera.height) & ~seen
        index = torch.where(inside)[0]
        row, column = row[index].long(), column[index].long()
        nearest = lidar_image(camera, positions)[row, column]
        shown = depth[index] <= nearest * (1 + SURFACE)
        if view.load_mask is not None:
            shown &= view.load_mask()[row, column]
        index, row, column = index[shown], row[shown], column[shown]
        colours[index] = (view.load()[row, column] * 255).round().byte()
        seen[index] = True
    return colours, seen


@dataclass(frozen=True, kw_only=True, eq=False)
class Depths:
    """How far a sweep's rays went, by direction."""

    origin: Float[Tensor, "3"]
    """Float64: where the sensor was."""
    frame: Float64[np.ndarray, "3 3"]
    """Rows: two directions along the ground, and up."""
    nearest: Float64[np.ndarray, "rows columns"]
    """Shortest ray of the 3 x 3 cells around each; inf where none went."""
    known: Bool[np.ndarray, "rows columns"]
    """Whether rays went through enough of those cells, and above the direction as well as below it: what the lowest
    beam hits goes with the sensor, and the next sweep does not look through it but misses it."""


def depths(sweep: Sweep, up: Float[Tensor, "3"]) -> Depths:
    """Sort a sweep's rays into cells of `CELL` radians, by height and by turn about the sensor's axis.

    Args:
        sweep: Its rays begin at its origin.
        up: Unit vector away from the ground, float64: beams lie one above the other.
    """
    frame = _upright(up)
    row, column, ranges = _polar(sweep.positions.double(), sweep.origin, frame)
    image = np.full((round(np.pi / CELL) + 1, round(2 * np.pi / CELL)), np.inf)
    np.minimum.at(image, (row, column), ranges)
    around = {"size": 3, "mode": ("nearest", "wrap")}
    cells = uniform_filter(np.isfinite(image).astype(float), **around) * 9
    wide = np.pad(maximum_filter1d(np.isfinite(image), 3, axis=1, mode="wrap"), ((2, 2), (0, 0)))
    # two rows on either side: beams are up to 0.02 apart, so one row of CELL may be empty between them
    below = np.logical_or(wide[:-4], wide[1:-3])
    above = np.logical_or(wide[3:-1], wide[4:])
    return Depths(
        origin=sweep.origin,
        frame=frame,
        nearest=minimum_filter(image, **around),
        known=(cells > LEAST_CELLS - 0.5) & below & above,
    )


def looked_through(positions: Float[Tensor, "n 3"], sweeps: Sequence[Depths]) -> Tensor:
    """Number of sweeps whose rays passed each point and went on.

    A sweep counts where all its rays in the cells around a point's direction are longer than the
    point is far.

    Args:
        positions: Points, float64, scene frame.
        sweeps: Sweeps of other moments.

    Returns: One int64 a point.

    Source: ours; the idea is that of Kim and Kim 2020, "Remove, then Revert", Sec. III.
    """
    votes = np.zeros(len(positions), np.int64)
    for sweep in sweeps:
        row, column, far = _polar(positions, sweep.origin, sweep.frame)
        passed = (1 + BEYOND) * far < sweep.nearest[row, column]
        votes += passed & sweep.known[row, column]
    return torch.from_numpy(votes)


def _upright(up: Float[Tensor, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Two directions along the ground, and up; the scene's own axes where z is up."""
    away = up.double().numpy()
    across = np.eye(3)[np.abs(away).argmin()]
    across = across - (across @ away) * away
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(away, across), away])


def _polar(
    positions: Float[Tensor, "n 3"],
    origin: Float[Tensor, "3"],
    frame: Float64[np.ndarray, "3 3"],
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Row and column of each position's cell, and its distance from where the sensor was."""
    away = (positions - origin).numpy() @ frame.T
    far = np.linalg.norm(away, axis=1)
    height = np.arcsin(np.clip(away[:, 2] / np.maximum(far, 1e-9), -1, 1))
    turn = np.arctan2(away[:, 1], away[:, 0])
    row = np.floor((height + np.pi / 2) / CELL).astype(np.int64)
    column = np.floor((turn + np.pi) / CELL).astype(np.int64)
    return row, column % round(2 * np.pi / CELL), far
