"""What changes with the step: learning rates, the SH degree, and how schedules shrink."""

import math
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


def round_steps(again: int, iterations: int) -> int:
    """Steps of a round in a run of some length, rounded up so that no run ends with the first steps of another.

    Args:
        again: Steps of a round in a run of 30,000 steps; 0: the run is one round.
        iterations: Steps of the run, >= 1.
    """
    return -(-again * min(iterations, FULL_LENGTH) // FULL_LENGTH)


def since(step: int, again: int) -> int:
    """Number of a step in the round that it belongs to, from 1.

    Args:
        step: Number of the step in the run, from 1.
        again: Steps of a round, >= 1; 0: the run is one round.
    """
    return (step - 1) % again + 1 if again else step


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
    again: int = 0
    """Step after which all rates begin again as at the first, for a round of as many steps, and so on; steps of a
    30,000 step run, which a shorter one shrinks in proportion. 0: one round (the release). What
    `density.again` adds late has to learn as fast as what was there from the start."""

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


def in_rounds(rate: Schedule, again: int) -> Schedule:
    """A rate that begins again after so many steps, and runs in each such round as in a run of its length.

    Args:
        rate: Of a whole run.
        again: Steps of a round in a run of 30,000 steps, shrunk in a shorter one; 0: the rate as it is.

    Source: Loshchilov and Hutter 2017, "SGDR", Sec. 3, for warm restarts; with rounds of one length.
    """
    return partial(_in_rounds, rate, again) if again else rate


def _in_rounds(rate: Schedule, again: int, step: int, total: int) -> float:
    length = round_steps(again, total)
    return rate(since(step, length), length)


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
