"""Small photos first: steps are cheap while the model is coarse."""

import math
from dataclasses import dataclass, replace

from splatproof.datasets.resize import resample, scale_intrinsics
from splatproof.datasets.truth_image import shrink_mask
from splatproof.methods.training.schedules import require
from splatproof.reference.types.scene import View

LEAST_SIDE = 16
"""Pixels that no side of a shrunk photo falls below: SSIM looks through windows of 11."""


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Size of the photos as training goes on: shrunk at first, halfway nearer to their own size at each level.

    With L halvings, level i of 0 ... L - 1 shrinks by `coarsest` / 2^i and takes 2^i / (2^L - 1) of the
    steps before `full_from`.

    Source: DashGaussian (Chen et al. 2025) for the idea, with a schedule from the photos' spectrum;
    fixed levels, so that each photo is shrunk a few times and not in every step: ours.
    """

    coarsest: float = 1.0
    """Factor, >= 1, by which photos are shrunk at the first step; 1: they never are."""
    full_from: float = 0.5
    """Share of the steps, 0 to 1, from which on photos have their full size."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(1 <= self.coarsest < math.inf, "resolution.coarsest", self.coarsest, ">= 1")
        require(0 <= self.full_from <= 1, "resolution.full_from", self.full_from, "0 to 1")

    @property
    def levels(self) -> int:
        """Number of sizes before the full one."""
        return math.ceil(math.log2(self.coarsest))

    def factor(self, step: int, total: int) -> float:
        """Factor, >= 1, by which the photos of a step are shrunk; it never rises from step to step.

        Args:
            step: Number of the step, from 1.
            total: Steps of the run.
        """
        done, whole = (step - 1) / total, self.full_from
        if done >= whole:
            return 1.0
        level = int(math.log2(1 + done / whole * (2**self.levels - 1)))
        return max(1.0, self.coarsest / 2**level)

    def relative_pixels(self, total: int) -> float:
        """Pixels of all steps as a share of what they are at full size, in (0, 1].

        Args:
            total: Steps of the run.
        """
        return sum(self.factor(step, total) ** -2 for step in range(1, total + 1)) / total


def shrunk(view: View, factor: float) -> View:
    """A view with an image so many times smaller: the mean over each new pixel's rectangle.

    A pixel is valid where all that it covers is. What else a view has, depth priors and sweeps
    included, is left out.

    Args:
        view: One to train on.
        factor: Factor, >= 1, on both sides of the image; no side falls below 16 pixels.
    """
    camera = view.camera
    size = tuple(
        min(side, max(LEAST_SIDE, round(side / factor))) for side in (camera.width, camera.height)
    )
    old, load_mask = (camera.width, camera.height), view.load_mask
    return View(
        name=view.name,
        camera=replace(
            camera, width=size[0], height=size[1],
            K=scale_intrinsics(camera.K, old, (size[0], size[1])),
        ),
        load=lambda: resample(view.load(), (size[0], size[1]), "area"),
        load_mask=None
        if load_mask is None
        else lambda: shrink_mask(load_mask(), (size[0], size[1]), "area"),
        time=view.time, sensor=view.sensor, appearance=view.appearance,
    )  # fmt: skip
