"""What changes with the step: learning rates, the SH degree, and how schedules shrink."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.model import Schedule

LEAST_CELL = 0.25
"""Pixels between points that are matched: flow gives a match a pixel, so finer voxels have one each."""
FULL_LENGTH = 30_000
"""Steps of a full run; schedules are written down for this length."""


def shrink(iterations: int) -> float:
    """Factor in (0, 1] on every step count of a schedule: a shorter run is a whole one, sooner.

    Longer runs than 30,000 steps keep the counts as they are.

    Args:
        iterations: Number of steps of the run, >= 1.

    Source: ours.
    """
    return min(1.0, iterations / FULL_LENGTH)


def shrunk_interval(
    interval: int, least: int, fewest: int, *, start: int, stop: int, iterations: int
) -> int:
    """Steps between densifications of a run of some length.

    A full run keeps its interval, and a shorter one that shrunk to no less than `least`; but where
    fewer than `fewest` multiples of it lay between start and stop it is (stop - start - 1) / fewest.

    Args:
        interval: Steps between densifications in a run of 30,000 steps, >= 1.
        least: What it is shrunk to at least, >= 1.
        fewest: Densifications that a shorter run has at least, as far as it has steps; >= 0.
        start: Last step without densification, of this run.
        stop: Step from which on nothing is densified, of this run.
        iterations: Steps of this run, >= 1.

    Source: ours.
    """
    factor = shrink(iterations)
    usual = max(round(interval * factor), least)
    between = stop - start - 1
    times = max(0, stop - 1) // usual - start // usual
    if factor == 1 or between < 1 or times >= fewest:
        return usual
    return max(1, between // fewest)


def restarts(iterations: int, rounds: int) -> tuple[int, ...]:
    """Steps after which a round of a training begins, but for the first, which begins with it.

    Rounds are of one length, the last of what is left.

    Args:
        iterations: Steps of the training, >= 1.
        rounds: Number of rounds, >= 1; where that leaves no step for the last ones there are fewer.

    Source: Loshchilov and Hutter 2017, "SGDR: Stochastic Gradient Descent with Warm Restarts", Sec. 3, with rounds of
    one length.
    """
    length = -(-iterations // rounds)
    return tuple(range(length, iterations, length))


def round_of(step: int, total: int, restarts: Sequence[int]) -> tuple[int, int]:
    """Number of a step in its round, from 1, and steps of that round.

    Args:
        step: Number of the step in the training, from 1.
        total: Steps of the training; one that is told another number on the way has a longer or shorter last round.
        restarts: Steps after which rounds begin, rising.
    """
    begun = max((after for after in restarts if after < step), default=0)
    end = min((after for after in restarts if step <= after < total), default=total)
    return step - begun, end - begun


def require_cell(cell: float) -> None:
    """Refuse voxels of added points that would hold a match each, at the price of all of them.

    Args:
        cell: Edge of a voxel in pixels; 0: no points are added.
    Raises: UsageError below LEAST_CELL.
    """
    require(cell == 0 or LEAST_CELL <= cell < math.inf, "dense_cell", cell,
            f"0, or {LEAST_CELL} and more")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Learning rates (defaults of the 3DGS release); 0 holds a quantity still."""

    means: float = 1.6e-4
    """Learning rate of positions at the first step, in extents of the scene."""
    means_final: float = 1.6e-6
    """Learning rate of positions at the last step, in extents of the scene; log-linear in between.
    0: it stays as at the first step."""
    sh_dc: float = 2.5e-3
    """Learning rate of colour that is the same from all sides (SH band 0)."""
    sh_rest: float = 1.25e-4
    """Learning rate of view-dependent colour (all higher SH bands)."""
    opacity_logits: float = 0.05
    """Learning rate of opacity logits (the release: 0.05 in 2023, 0.025 since 2024)."""
    log_scales: float = 5e-3
    """Learning rate of log scales."""
    quaternions: float = 1e-3
    """Learning rate of rotations, as quaternions that are not normalised."""
    settle: float = 1.0
    """Factor on all rates but that of positions at the last step, reached log-linearly from the
    middle of the run on; 1: constant, as in the release. Single views pull on colours, opacities
    and scales until the end; smaller last steps average their pulls."""

    def __post_init__(self) -> None:
        """Refuse rates that are not finite and >= 0."""
        for name, value in vars(self).items():
            require(math.isfinite(value) and value >= 0, f"rates.{name}", value, ">= 0")


def require(holds: bool, setting: str, value: object, expected: str) -> None:
    """Refuse a setting unless a condition holds.

    Args:
        holds: The condition.
        setting: Name of the setting, as settings files and the command line write it.
        value: Its value.
        expected: What would do, in a few words.

    Raises: UsageError naming the setting, its value and what was expected.
    """
    if not holds:
        raise UsageError(f"setting {setting} is {value!r}, expected {expected}")


def log_linear(first: float, last: float, *, factor: float = 1.0) -> Schedule:
    """A rate that falls from `first` to `last`: factor exp((1 - u) ln first + u ln last), u = step / total.

    Where an end is 0 the rate stays at `first`.

    Args:
        first: Rate at the beginning, >= 0.
        last: Rate at the last step, >= 0; beyond it stays.
        factor: Factor on the whole rate: the scene's extent for positions.

    Source: the 3DGS release (its delay is never active).
    """
    return partial(_log_linear, first, last, factor)


def _log_linear(first: float, last: float, factor: float, step: int, total: int) -> float:
    if first == 0 or last == 0:
        return first * factor
    share = min(max(step / total, 0.0), 1.0)
    return math.exp((1 - share) * math.log(first) + share * math.log(last)) * factor


def settling(rate: float, settle: float = 1.0) -> Schedule:
    """A rate that is constant to the middle of the run, then falls log-linearly to `rate` `settle`.

    Args:
        rate: Rate in the first half, >= 0.
        settle: Factor at the last step; 1: constant throughout.

    Source: ours.
    """
    return partial(_settling, rate, settle)


def _settling(rate: float, settle: float, step: int, total: int) -> float:
    return rate * settle ** max(0.0, 2 * step / total - 1)


def active_degree(step: int, every: float, highest: int) -> int:
    """Degree of the spherical harmonics in use: one more every `every` steps, from 0.

    Args:
        step: Number of the step, from 1.
        every: Steps until one more degree is used; 0: the highest from the start.
        highest: Highest degree, 0 to 3.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 7.1 and its release.
    """
    return min(highest, int(step / every)) if every > 0 else highest
