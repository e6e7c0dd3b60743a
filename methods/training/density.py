"""Adaptive density control: where Gaussians are cloned, split, pruned and made transparent."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.kernels import step as kernels
from splatproof.methods.training.schedules import require, shrink
from splatproof.reference.rasterizer.rotation import rotation_matrix
from splatproof.reference.types.gaussians import Gaussians

SPLIT_SHRINK = 1.6
"""A child's scale is its parent's divided by this (0.8 times the 2 children)."""
RESET_OPACITY = 0.01
"""A reset leaves no Gaussian more opaque than this."""


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
    """Steps between densifications; a short run shrinks it to no less than `least_interval`."""
    least_interval: int = 100
    """Fewest steps between densifications in a short run: statistics need several views."""
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
    first. None: no bound."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in (
            "start", "stop", "reset_interval", "gradient", "split_gradient", "split_size",
            "largest_size",
        ):  # fmt: skip
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
    pulled = gradient >= settings.gradient
    if absolute is not None:
        pulled = torch.where(small, pulled, absolute >= settings.split_gradient)
    chosen = pulled & ~fixed
    if settings.most is not None:
        chosen &= _largest(gradient.where(chosen, -1), max(0, settings.most - len(gaussians)))
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


def reset_opacity(logits: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Logits of min(opacity, 0.01)."""
    return logits.clamp(max=math.log(RESET_OPACITY / (1 - RESET_OPACITY)))


@dataclass(frozen=True, kw_only=True)
class RowRules:
    """Which rows density control leaves alone, by the labels of the rows."""

    growing: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows that may be cloned and split."""
    fixed: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows that are never removed either."""
    steady: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows whose opacity a reset leaves alone."""


class DensityControl:
    """Adaptive density control of explicit Gaussians, as the 3DGS release does it."""

    def __init__(
        self,
        settings: Density,
        *,
        iterations: int,
        extent: float,
        rules: RowRules | None = None,
        statistic: Statistic = "signed",
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            rules: Which rows are left alone; None: none are.
            statistic: Gradient that is compared with the threshold.
        """
        factor = shrink(iterations)
        self.settings = replace(
            settings,
            start=round(settings.start * factor),
            stop=round(settings.stop * factor),
            interval=max(round(settings.interval * factor), settings.least_interval),
            reset_interval=round(settings.reset_interval * factor),
        )
        self.extent, self.rules = extent, rules
        self.statistic: Statistic = statistic
        self.needs: frozenset[Statistic] = frozenset(
            {statistic, "absolute"} if settings.split_gradient else {statistic}
        )
        self.gradient_sum = self.absolute_sum = self.seen = torch.zeros(0)

    def watches(self, step: int) -> bool:
        """Whether the statistics of a step are needed.

        Args:
            step: Number of the step, from 1.
        """
        return step < self.settings.stop

    def observe(self, seen: Observation) -> None:
        """Add one view: the norm of the 2D gradient where a Gaussian was seen.

        Args:
            seen: What the view says.
        """
        if len(self.gradient_sum) != seen.count:
            self._clear(seen.count, seen.radii.device)
        gradient = seen.signed if self.statistic == "signed" else seen.absolute
        assert gradient is not None
        if self.settings.split_gradient:
            norm = torch.where(seen.radii > 0, seen.gradient_norm("absolute"), 0)
            self.absolute_sum += seen.by_row(norm)
        if seen.rows is None and gradient.device.type == "cpu":
            kernels.observe(gradient, seen.radii, seen.camera, self.gradient_sum, self.seen)
            return
        visible = seen.radii > 0
        norm = torch.where(visible, seen.gradient_norm(self.statistic), 0)
        self.gradient_sum += seen.by_row(norm)
        self.seen += seen.by_row(visible.to(norm))

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Densify, then reset opacities, each where its step has come.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, with means, quaternions, log_scales and opacity_logits.
            generator: Source of the children's positions.
        """
        if self.densifies(step):
            yield self.densify(step, parameters, generator)
        if self.resets(step):
            yield self.reset(parameters)

    def densifies(self, step: int) -> bool:
        """Whether a step ends with a densification."""
        settings = self.settings
        return settings.start < step < settings.stop and step % settings.interval == 0

    def resets(self, step: int) -> bool:
        """Whether a step ends with an opacity reset."""
        every = self.settings.reset_interval
        return every > 0 and step < self.settings.stop and step % every == 0

    def densify(self, step: int, parameters: Parameters, generator: torch.Generator) -> Edit:
        """Clone, split and prune by the statistics so far, and forget them.

        Args:
            step: Number of the step, from 1.
            parameters: The model's tensors, as for `edits`.
            generator: Source of the children's positions.
        """
        every = self.settings.reset_interval
        fixed = None
        if len(self.gradient_sum) != len(parameters):  # no view was observed since
            self._clear(len(parameters), parameters.rows["means"].device)
        gradient, absolute = (
            total / self.seen.clamp(min=1) for total in (self.gradient_sum, self.absolute_sum)
        )
        if self.rules is not None:
            resting = ~self.rules.growing(parameters)
            gradient[resting] = absolute[resting] = -1  # below any threshold
            fixed = self.rules.fixed(parameters)
        rows = densify(
            _shapes(parameters), gradient, self.settings, extent=self.extent,
            prune_large=0 < every < step, generator=generator, fixed=fixed,
            absolute=absolute if self.settings.split_gradient else None,
        )  # fmt: skip
        self._clear(len(rows.parents), gradient.device)
        return Edit(
            parents=rows.parents, fresh=rows.fresh,
            values={"means": rows.means, "log_scales": rows.log_scales},
        )  # fmt: skip

    def reset(self, parameters: Parameters) -> Edit:
        """Make everything nearly transparent that the rules do not hold.

        Args:
            parameters: The model's tensors, with opacity_logits.
        """
        before = parameters.rows["opacity_logits"].detach()
        logits = reset_opacity(before)
        if self.rules is not None:
            logits = torch.where(self.rules.steady(parameters), before, logits)
        return Edit(values={"opacity_logits": logits}, forget=frozenset({"opacity_logits"}))

    def _clear(self, count: int, device: torch.device) -> None:
        """Forget the statistics."""
        self.gradient_sum = torch.zeros(count, device=device)
        self.absolute_sum = torch.zeros(count, device=device)
        self.seen = torch.zeros(count, device=device)

    def state(self) -> dict[str, Tensor]:
        """The statistics as named tensors."""
        return {
            "gradient_sum": self.gradient_sum, "absolute_sum": self.absolute_sum, "seen": self.seen,
        }  # fmt: skip

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        device = self.gradient_sum.device
        self.gradient_sum = state["gradient_sum"].clone().to(device)
        self.absolute_sum = state["absolute_sum"].clone().to(device)
        self.seen = state["seen"].clone().to(device)


def _shapes(parameters: Parameters) -> Gaussians:
    """The rows without their colours, which density control does not look at."""
    rows = {name: value.detach() for name, value in parameters.rows.items()}
    return Gaussians(
        means=rows["means"], quaternions=rows["quaternions"], log_scales=rows["log_scales"],
        opacity_logits=rows["opacity_logits"], sh=rows["means"].new_zeros(len(rows["means"]), 1, 3),
    )  # fmt: skip
