"""Adaptive density control: where Gaussians are cloned, split, pruned and made transparent."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.training.schedules import require
from splatproof.reference.rasterizer.rotation import rotation_matrix
from splatproof.reference.types.gaussians import Gaussians

SPLIT_SHRINK = 1.6
"""A child's scale is its parent's divided by this (0.8 times the 2 children)."""
RESET_OPACITY = 0.01
"""A reset leaves no Gaussian more opaque than this."""
Pace = Literal["free", "even"]
"""How fast densification may come to the cap on Gaussians: at once, or by equal shares of what is left."""


@dataclass(frozen=True, kw_only=True)
class Density:
    """Adaptive density control: when and where Gaussians are added and removed (defaults of the
    3DGS release). Steps are those of a 30,000 step run; a shorter run shrinks them in
    proportion."""

    start: int = 500
    """Last step without densification: Gaussians are cloned, split and removed after it."""
    stop: int = 15_000
    """Step from which on nothing is densified and no opacity is reset."""
    interval: int = 100
    """Steps between densifications; a short run shrinks it to no less than `least_interval`, unless
    `fewest` asks for more densifications."""
    least_interval: int = 100
    """Fewest steps between densifications in a short run: statistics need several views."""
    fewest: int = 0
    """Fewest densifications of a short run, whatever `least_interval` says; 0: as many as come. A run that is to
    be judged as one that densified asks for some. They can cost a run of hundreds of steps more than they
    give it, so none are asked for by default."""
    gradient: float = 2e-4
    """Pull from which a Gaussian is cloned or split: mean norm of the loss's gradient by its
    position in the image, in units of half the image. Smaller values give more Gaussians."""
    split_gradient: float = 0.0
    """Mean norm of the sums of absolute gradients by the 2D position (per pixel and coordinate, so that
    they do not cancel), in the same units, from which a large Gaussian is split; small ones are cloned
    by `gradient` all the same (AbsGS: 4e-4). 0: `gradient` decides on both."""
    split_size: float = 0.01
    """Largest scale up to which a Gaussian is cloned, as a share of the scene's extent (1.1 times
    the radius of the training cameras); a larger one is split."""
    least_opacity: float = 0.005
    """Opacity, 0 to 1, below which a densification removes a Gaussian."""
    largest_size: float = 0.1
    """Largest scale, as a share of the scene's extent, that survives a densification after the
    first opacity reset."""
    reset_interval: int = 3000
    """Steps between opacity resets, which leave no Gaussian more opaque than 0.01; 0: never."""
    most: int | None = None
    """Most Gaussians that densification may lead to: those with the largest gradients are densified
    first, with `split_gradient` those whose gradient is the largest multiple of its threshold. None: no
    bound."""
    pace: Pace = "free"
    """How fast. free: any densification may lead to `most`; even: each may add an equal share of the room that is
    left up to `most`, one part for it and one for each densification to come, so that what is pulled at
    early does not take the room of what shows to be wanted later."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in (
            "start", "stop", "fewest", "reset_interval", "gradient", "split_gradient", "split_size",
            "largest_size",
        ):  # fmt: skip
            value = getattr(self, name)
            require(value >= 0, f"density.{name}", value, ">= 0")
        for name in ("interval", "least_interval"):
            value = getattr(self, name)
            require(value >= 1, f"density.{name}", value, ">= 1")
        require(0 <= self.least_opacity < 1, "density.least_opacity", self.least_opacity, "[0, 1)")
        require(self.most is None or self.most >= 1, "density.most", self.most, ">= 1 or None")
        bounded = self.pace == "free" or self.most is not None
        require(
            bounded,
            "density.pace",
            self.pace,
            "free where density.most is None: there is no room to share out",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """How the rows of a model change."""

    parents: Int[Tensor, " m"]
    """Old row that each new row descends from."""
    fresh: Bool[Tensor, " m"]
    """Rows that start with zero moments."""
    means: Float[Tensor, "m 3"]
    log_scales: Float[Tensor, "m 3"]


@torch.no_grad()
def densify(
    gaussians: Gaussians,
    gradient: Float[Tensor, " n"],
    settings: Density,
    *,
    extent: float,
    prune_large: bool,
    generator: torch.Generator,
    fixed: Bool[Tensor, " n"] | None = None,
    absolute: Float[Tensor, " n"] | None = None,
) -> Rows:
    """Clone small and split large Gaussians that are pulled at; remove those that do not show.

    A clone is an exact copy. A split makes two children at mu + R (s * xi), xi ~ N(0, I), with
    scale s / 1.6, in the parent's place. Never removes the last Gaussian.

    Args:
        gaussians: The model; its colours are not looked at.
        gradient: Mean norm of the 2D gradient, in units of half the image; 0 where never seen.
        settings: Thresholds; its steps are not looked at.
        extent: Size of the scene in scene units.
        prune_large: Whether Gaussians larger than `largest_size` are removed too.
        generator: Source of the children's positions.
        fixed: Rows that are neither cloned, split nor removed; None: none.
        absolute: Mean norm of the absolute 2D gradients, by which large Gaussians are split where
            `split_gradient` is not 0; None: `gradient` decides on both.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5.2; rules of its release, without
        the test on screen size, which never fires there.
    """
    size = gaussians.scales.amax(dim=1)
    fixed = torch.zeros_like(size, dtype=torch.bool) if fixed is None else fixed
    small = size <= settings.split_size * extent
    pulled, pull = gradient >= settings.gradient, gradient
    if absolute is not None:
        pulled = torch.where(small, pulled, absolute >= settings.split_gradient)
        least = max(settings.gradient, torch.finfo(gradient.dtype).tiny)
        pull = torch.where(small, gradient / least, absolute / settings.split_gradient)
    chosen = pulled & ~fixed
    if settings.most is not None:
        chosen &= _largest(pull.where(chosen, -1), max(0, settings.most - len(gaussians)))
    split = torch.where(chosen & ~small)[0].repeat(2)
    clone = torch.where(chosen & small)[0]
    keep = torch.where(~(chosen & ~small))[0]

    parents = torch.cat([keep, clone, split])
    means, log_scales = gaussians.means[parents], gaussians.log_scales[parents]
    if len(split):
        draw = torch.randn(len(split), 3, generator=generator).to(means)
        local = gaussians.scales[split] * draw
        turned = rotation_matrix(gaussians.quaternions[split]) @ local[:, :, None]
        means[-len(split) :] += turned[:, :, 0]
        log_scales[-len(split) :] -= math.log(SPLIT_SHRINK)

    opacities = gaussians.opacities[parents]
    gone = opacities < settings.least_opacity
    if prune_large:
        gone |= log_scales.exp().amax(dim=1) > settings.largest_size * extent
    gone &= ~fixed[parents]
    if gone.all():
        gone[opacities.argmax()] = False
    fresh = torch.arange(len(parents), device=size.device) >= len(keep)
    stay = ~gone
    return Rows(
        parents=parents[stay], fresh=fresh[stay], means=means[stay], log_scales=log_scales[stay]
    )


def _largest(values: Float[Tensor, " n"], count: int) -> Bool[Tensor, " n"]:
    """Mask of the `count` largest values, ties by index."""
    mask = torch.zeros_like(values, dtype=torch.bool)
    mask[torch.sort(values, descending=True, stable=True).indices[:count]] = True
    return mask


def reset_opacity(logits: Float[Tensor, " n"], most: float = RESET_OPACITY) -> Float[Tensor, " n"]:
    """Logits of min(opacity, most).

    Args:
        logits: Opacity logits.
        most: Opacity in (0, 1) that none is left above.
    """
    return logits.clamp(max=math.log(most / (1 - most)))
