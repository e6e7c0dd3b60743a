"""What changes with the step: learning rates, the SH degree, and how schedules shrink."""

import math
from dataclasses import dataclass
from functools import partial

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.model import Schedule

FULL_LENGTH = 30_000
"""Iterations of a full run; schedules are written down for this length."""


def shrink(iterations: int) -> float:
    """Factor in (0, 1] on every step count of a schedule: a shorter run is a whole one, sooner.

    Longer runs than 30,000 iterations keep the counts as they are.

    Args:
        iterations: Length of the run.

    Source: ours.
    """
    return min(1.0, iterations / FULL_LENGTH)


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Adam's learning rates (defaults of the 3DGS release)."""

    means: float = 1.6e-4
    """Rate of positions at the first step, times the scene's extent."""
    means_final: float = 1.6e-6
    """Rate of positions at the last step, times the extent; log-linear in between."""
    sh_dc: float = 2.5e-3
    """Rate of the constant SH band."""
    sh_rest: float = 1.25e-4
    """Rate of all higher SH bands."""
    opacity_logits: float = 0.05
    """Rate of opacity logits (0.05 in the release of 2023, 0.025 since 2024)."""
    log_scales: float = 5e-3
    """Rate of log scales."""
    quaternions: float = 1e-3
    """Rate of unnormalised quaternions."""
    settle: float = 1.0
    """Factor on all rates but that of positions at the last step, reached log-linearly from the
    middle of the run on; 1: constant, as in the release. Single views pull on colours, opacities
    and scales until the end; smaller last steps average their pulls."""

    def __post_init__(self) -> None:
        """Refuse rates that are not finite and >= 0."""
        for name, value in vars(self).items():
            require(math.isfinite(value) and value >= 0, f"rates.{name}", value, ">= 0")


def require(holds: bool, setting: str, value: object, expected: str) -> None:
    """Raise UsageError, naming the setting, its value and what was expected, unless it holds."""
    if not holds:
        raise UsageError(f"setting {setting} is {value!r}, expected {expected}")


def log_linear(first: float, last: float, *, factor: float = 1.0) -> Schedule:
    """A rate that falls from `first` to `last`: factor exp((1 - u) ln first + u ln last), u = step / total.

    Where an end is 0 the rate stays at `first`.

    Args:
        first: Rate at the beginning, >= 0.
        last: Rate at the last step, >= 0; beyond it stays.
        factor: On the whole rate: the scene's extent for positions.

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
        rate: In the first half, >= 0.
        settle: Factor at the last step; 1: constant throughout.

    Source: ours.
    """
    return partial(_settling, rate, settle)


def _settling(rate: float, settle: float, step: int, total: int) -> float:
    return rate * settle ** max(0.0, 2 * step / total - 1)


def active_degree(step: int, every: float, highest: int) -> int:
    """Degree of the spherical harmonics in use: one more every `every` steps, from 0.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 7.1 and its release.
    """
    return min(highest, int(step / every)) if every > 0 else highest
