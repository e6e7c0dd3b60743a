"""What can be chosen about growing and pruning of moving anchors."""

from dataclasses import dataclass, replace
from typing import Literal

from splatproof.methods.training.schedules import require, shrink

Growing = Literal["adaptive", "uniform"]
"""Where many Gaussians of a voxel are pulled at: anchors in its finer parts, or one in the voxel."""
FEWEST_ADJUSTMENTS = 4
"""Adjustments that even the shortest run has between its start and stop of growing."""


@dataclass(frozen=True, kw_only=True)
class HdgsDensity:
    """Growing and pruning. Steps are those of a 30,000 iteration run; shorter runs shrink them."""

    start: int = 500
    """No statistics up to this step."""
    stop: int = 15_000
    """No statistics, growing and pruning from this step on."""
    interval: int = 500
    """Steps between adjustments (N_g and N_p). Shrinks to no less than `least_interval`, but a run of any
    length has four adjustments."""
    least_interval: int = 100
    """Fewest steps between adjustments in a short run: statistics need several views."""
    growing: Growing = "adaptive"
    """Whether dense voxels grow in their finer parts (GDG), or all alike."""
    gradient: float = 5e-4
    """Mean norm of the loss's gradient by the 2D position, in units of half the image, from which a
    voxel of Gaussians grows."""
    density: float = 5.0
    """Gaussians in a voxel from which its finer parts grow."""
    drawn_share: float = 0.05
    """Share of an interval's views that a Gaussian must have been drawn in before it is counted."""
    temporal_gradient: float = 2e-4
    """Mean |d loss / d peak time| of a voxel's anchors from which it may grow in time; 0: none does."""
    temporal_share: float = 0.25
    """Share of the voxels that may grow in time that do, drawn at random."""
    opacity: float = 0.005
    """Mean opacity of an anchor's Gaussians below which it is pruned; 0: none is."""
    unvisited: int = 500
    """Views that an anchor may stay out of before it is pruned (UR), and at least two passes over all of
    them; 0: anchors are never pruned for it."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("start", "stop", "gradient", "density", "temporal_gradient", "unvisited"):
            require(getattr(self, name) >= 0, f"density.{name}", getattr(self, name), ">= 0")
        for name in ("interval", "least_interval"):
            require(getattr(self, name) >= 1, f"density.{name}", getattr(self, name), ">= 1")
        for name in ("drawn_share", "temporal_share", "opacity"):
            require(0 <= getattr(self, name) <= 1, f"density.{name}", getattr(self, name), "0 to 1")

    def shrunk(self, iterations: int) -> "HdgsDensity":
        """The same with the steps of a run of some length.

        Args:
            iterations: Steps of the run.
        """
        factor = shrink(iterations)
        start, stop = (round(step * factor) for step in (self.start, self.stop))
        interval = max(round(self.interval * factor), self.least_interval)
        most = max(1, (stop - start) // (FEWEST_ADJUSTMENTS + 1))
        return replace(self, start=start, stop=stop, interval=min(interval, most))
