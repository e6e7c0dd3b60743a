"""What pvg starts from: sparse points that stay, and LiDAR returns at the moments they were hit."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.dynamic import sky
from splatproof.methods.dynamic.sweep_motion import in_motion
from splatproof.methods.dynamic.sweep_points import TimedPoints, timed_points
from splatproof.methods.dynamic.terms import require_sweeps
from splatproof.methods.dynamic.times import Clock
from splatproof.methods.pvg.settings import Settings
from splatproof.methods.training.initialise import from_points
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, SparsePoints


def started(scene: Scene, settings: Settings, clock: Clock, seed: int) -> Parameters:
    """The tensors at the start.

    Args:
        scene: With the sparse points to start from.
        settings: What is chosen about the method.
        clock: What model time is.
        seed: Seed of the draw of returns.

    Raises: DataError if there is no point or no training view, or no sweep where some are asked for.
    """
    parts = [_rows(scene, settings, torch.zeros(len(scene.points)), still(settings, clock))]
    if settings.start.sweep_points:
        term = "lidar.weight = 0 and " if settings.lidar.weight else ""
        require_sweeps(scene, f"{term}start.sweep_points = 0")
        chosen = choose(in_motion(timed_points(scene), scene.up), settings.start.sweep_points, seed)
        for points in by_moment(chosen):
            moved = bool(points.moved[0])
            span = settings.start.moving_span if moved else still(settings, clock)
            peaks = torch.tensor([clock.at(t) if moved else 0.0 for t in points.seconds.tolist()])
            rows = _rows(_with(scene, points), settings, peaks, span)
            if settings.start.velocities:
                rows["velocities"] = points.velocities / clock.second
            parts.append(rows)
    rows = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    return Parameters(rows, shared=sky.started(settings.sky))


def still(settings: Settings, clock: Clock) -> float:
    """Span of life in model time, at the start, of what does not move.

    Args:
        settings: start.still_span counts.
        clock: Its duration counts.
    """
    return settings.start.still_span * clock.duration


def choose(points: TimedPoints, most: int, seed: int) -> TimedPoints:
    """At most so many points: those that moved before others, each kind drawn evenly.

    Args:
        points: All that there are.
        most: How many are wanted at most.
        seed: Seed of the draw.
    """
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(points), generator=generator)
    first = (~points.moved[order]).long().argsort(stable=True)
    return points.take(order[first[:most]].sort().values)


def by_moment(points: TimedPoints) -> list[TimedPoints]:
    """The points in groups: moving ones by their moment, the others together.

    A Gaussian's size at the start is how far points of its group are apart.

    Args:
        points: What is grouped.
    """
    groups = [points.moved & (points.seconds == time) for time in points.seconds.unique()]
    return [points.take(group) for group in (~points.moved, *groups) if bool(group.any())]


def _with(scene: Scene, points: TimedPoints) -> Scene:
    """The scene with other sparse points."""
    count = len(points)
    own = SparsePoints(
        positions=points.positions, colours=points.colours,
        track_starts=torch.zeros(count + 1, dtype=torch.int64),
        track_views=torch.zeros(0, dtype=torch.int64),
    )  # fmt: skip
    return replace(scene, points=own)


def _rows(scene: Scene, settings: Settings, peaks: Tensor, span: float) -> dict[str, Tensor]:
    """Rows of the Gaussians that a scene's points become."""
    one: Gaussians = from_points(scene, degree=settings.sh_degree, opacity=settings.initial_opacity)
    return {
        "means": one.means, "sh_dc": one.sh[:, :1], "sh_rest": one.sh[:, 1:],
        "opacity_logits": one.opacity_logits, "log_scales": one.log_scales,
        "quaternions": one.quaternions, "peaks": peaks.float(),
        "log_spans": torch.full((len(one),), math.log(span)),
        "velocities": torch.zeros(len(one), 3),
    }  # fmt: skip
