"""Adaptive density control: where Gaussians are cloned, split, pruned and made transparent."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.kernels import step as kernels
from splatproof.methods.training.schedules import require, shrink
from splatproof.reference.rasterizer.rotation import rotation_matrix
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians

SPLIT_SHRINK = 1.6
"""A child's scale is its parent's divided by this (0.8 times the 2 children)."""
RESET_OPACITY = 0.01
"""A reset leaves no Gaussian more opaque than this."""


@dataclass(frozen=True, kw_only=True)
class Density:
    """Adaptive density control. Steps are those of a 30,000 iteration run; shorter runs shrink them."""

    start: int = 500
    """No densification up to this step."""
    stop: int = 15_000
    """No densification and no reset from this step on."""
    interval: int = 100
    """Steps between densifications. Shrinks to no less than `least_interval`."""
    least_interval: int = 100
    """Fewest steps between densifications in a short run: statistics need several views."""
    gradient: float = 2e-4
    """Mean norm of the loss's gradient by the 2D position, in units of half the image, from which
    a Gaussian is cloned or split."""
    split_size: float = 0.01
    """Largest scale, in extents, up to which a Gaussian is cloned; a larger one is split."""
    least_opacity: float = 0.005
    """More transparent Gaussians are removed."""
    largest_size: float = 0.1
    """Largest scale, in extents, that survives a densification after the first reset."""
    reset_interval: int = 3000
    """Steps between opacity resets; 0: never."""
    most: int | None = None
    """Cap on the number of Gaussians: those with the largest gradients are densified first.
    None: no cap."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("start", "stop", "reset_interval", "gradient", "split_size", "largest_size"):
            value = getattr(self, name)
            require(value >= 0, f"density.{name}", value, ">= 0")
        for name in ("interval", "least_interval"):
            value = getattr(self, name)
            require(value >= 1, f"density.{name}", value, ">= 1")
        require(0 <= self.least_opacity < 1, "density.least_opacity", self.least_opacity, "[0, 1)")
        require(self.most is None or self.most >= 1, "density.most", self.most, ">= 1 or None")


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
) -> Rows:
    """Clone small and split large Gaussians that are pulled at; remove those that do not show.

    A clone is an exact copy. A split makes two children at mu + R (s * xi), xi ~ N(0, I), with
    scale s / 1.6, in the parent's place. Never removes the last Gaussian.

    Args:
        gaussians: The model.
        gradient: Mean norm of the 2D gradient, in units of half the image; 0 where never seen.
        settings: Thresholds.
        extent: Size of the scene in scene units.
        prune_large: Whether Gaussians larger than `largest_size` are removed too.
        generator: For the children's positions.
        fixed: Rows that are neither cloned, split nor removed; None: none.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5.2; rules of its release, without
        the test on screen size, which never fires there.
    """
    size = gaussians.scales.amax(dim=1)
    fixed = torch.zeros(len(size), dtype=torch.bool) if fixed is None else fixed
    chosen = (gradient >= settings.gradient) & ~fixed
    if settings.most is not None:
        chosen &= _largest(gradient.where(chosen, -1), max(0, settings.most - len(gaussians)))
    small = size <= settings.split_size * extent
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
    fresh = torch.arange(len(parents)) >= len(keep)
    stay = ~gone
    return Rows(
        parents=parents[stay], fresh=fresh[stay], means=means[stay], log_scales=log_scales[stay]
    )


def _largest(values: Float[Tensor, " n"], count: int) -> Bool[Tensor, " n"]:
    """Mask of the `count` largest values, ties by index."""
    mask = torch.zeros(len(values), dtype=torch.bool)
    mask[torch.sort(values, descending=True, stable=True).indices[:count]] = True
    return mask


def reset_opacity(logits: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Logits of min(opacity, 0.01)."""
    return logits.clamp(max=math.log(RESET_OPACITY / (1 - RESET_OPACITY)))


class DensityControl:
    """Collects the statistics of the views and says when to densify and when to reset."""

    def __init__(self, settings: Density, *, iterations: int, extent: float, count: int) -> None:
        """Start without statistics for `count` Gaussians."""
        factor = shrink(iterations)
        self.settings = replace(
            settings,
            start=round(settings.start * factor),
            stop=round(settings.stop * factor),
            interval=max(round(settings.interval * factor), settings.least_interval),
            reset_interval=round(settings.reset_interval * factor),
        )
        self.extent = extent
        self.clear(count)

    def clear(self, count: int) -> None:
        """Forget the statistics."""
        self.gradient_sum = torch.zeros(count)
        self.seen = torch.zeros(count)

    def watches(self, step: int) -> bool:
        """Whether the statistics of this step are needed."""
        return step < self.settings.stop

    def observe(
        self, gradient: Float[Tensor, "n 2"], radii: Float[Tensor, " n"], camera: Camera
    ) -> None:
        """Add one view: the norm of the 2D gradient where the Gaussian was seen.

        Args:
            gradient: Loss by 2D position, per pixel.
            radii: 0 where not seen.
            camera: Of that view; its size turns pixels into units of half the image.
        """
        kernels.observe(gradient, radii, camera, self.gradient_sum, self.seen)

    def densifies(self, step: int) -> bool:
        """Whether this step ends with a densification."""
        settings = self.settings
        return settings.start < step < settings.stop and step % settings.interval == 0

    def resets(self, step: int) -> bool:
        """Whether this step ends with an opacity reset."""
        every = self.settings.reset_interval
        return every > 0 and step < self.settings.stop and step % every == 0

    def step(
        self,
        step: int,
        gaussians: Gaussians,
        generator: torch.Generator,
        fixed: Bool[Tensor, " n"] | None = None,
    ) -> Rows:
        """Densify from the statistics so far and forget them; `fixed` rows stay as they are."""
        every = self.settings.reset_interval
        rows = densify(
            gaussians,
            self.gradient_sum / self.seen.clamp(min=1),
            self.settings,
            extent=self.extent,
            prune_large=0 < every < step,
            generator=generator,
            fixed=fixed,
        )
        self.clear(len(rows.parents))
        return rows

    def state(self) -> dict[str, Tensor]:
        """The statistics as named tensors."""
        return {"gradient_sum": self.gradient_sum, "seen": self.seen}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        self.gradient_sum = state["gradient_sum"].clone()
        self.seen = state["seen"].clone()
