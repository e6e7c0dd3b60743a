"""Adaptive density control as a strategy: what it counts, and when it densifies and resets."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.kernels import step as kernels
from splatproof.methods.training.density import Density, densify, reset_opacity
from splatproof.methods.training.schedules import shrink, shrunk_interval
from splatproof.reference.types.gaussians import Gaussians

D = TypeVar("D", bound=Density)


@dataclass(frozen=True, kw_only=True)
class RowRules:
    """Which rows density control leaves alone, by the labels of the rows."""

    growing: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows that may be cloned and split."""
    fixed: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows that are never removed either."""
    steady: Callable[[Parameters], Bool[Tensor, " n"]]
    """Rows whose opacity a reset leaves alone."""


def shrunk(settings: D, iterations: int) -> D:
    """Density control whose steps are those of a run of some length.

    Args:
        settings: Steps of a 30,000 step run.
        iterations: Steps of the run.
    """
    factor = shrink(iterations)
    start, stop = round(settings.start * factor), round(settings.stop * factor)
    return replace(
        settings,
        start=start,
        stop=stop,
        interval=shrunk_interval(
            settings.interval,
            settings.least_interval,
            settings.fewest,
            start=start,
            stop=stop,
            iterations=iterations,
        ),
        reset_interval=round(settings.reset_interval * factor),
    )


def densifies(settings: Density, step: int) -> bool:
    """Whether a step ends with a densification.

    Args:
        settings: Density control whose steps are the run's own.
        step: Number of the step, from 1.
    """
    return settings.start < step < settings.stop and step % settings.interval == 0


def densifications_left(settings: Density, step: int) -> int:
    """Number of densifications from a step on, its own included.

    Args:
        settings: Density control whose steps are the run's own.
        step: Number of the step, from 1.
    """
    last = max(0, settings.stop - 1) // settings.interval
    return max(0, last - max(settings.start, step - 1) // settings.interval)


def most_after(settings: Density, step: int, count: int) -> int | None:
    """Most Gaussians that a step's densification may lead to: count + (most - count) / left at an even pace.

    A function of what is there now, so that nothing has to be kept between steps: where every
    densification takes what it may, the number rises by as many each time.

    Args:
        settings: Density control whose steps are the run's own.
        step: A step that ends with a densification.
        count: Gaussians before it.

    Returns: The number, rounded down; `most` where there are more; None: no bound.

    Source: ours.
    """
    if settings.pace == "free" or settings.most is None:
        return settings.most
    share = (settings.most - count) // max(1, densifications_left(settings, step))
    return min(settings.most, count + share)


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
        self.settings = shrunk(settings, iterations)
        self.extent, self.rules = extent, rules
        self.statistic: Statistic = statistic
        needs: set[Statistic] = {statistic, "absolute"} if settings.split_gradient else {statistic}
        self.needs = frozenset(needs)
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
        if seen.rows is None and gradient.device.type == "cpu":
            if self.settings.split_gradient:
                assert seen.absolute is not None
                again = torch.zeros_like(self.seen)  # how many saw them is counted below
                kernels.observe(seen.absolute, seen.radii, seen.camera, self.absolute_sum, again)
            kernels.observe(gradient, seen.radii, seen.camera, self.gradient_sum, self.seen)
            return
        visible = seen.radii > 0
        if self.settings.split_gradient:
            norm = torch.where(visible, seen.gradient_norm("absolute"), 0)
            self.absolute_sum += seen.by_row(norm)
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
        return densifies(self.settings, step)

    def most_after(self, step: int, count: int) -> int | None:
        """Most rows that a step's densification may lead to; None: no bound.

        Args:
            step: A step that ends with a densification.
            count: Rows before it.
        """
        return most_after(self.settings, step, count)

    def resets(self, step: int) -> bool:
        """Whether a step ends with an opacity reset."""
        every = self.settings.reset_interval
        return every > 0 and step < self.settings.stop and step % every == 0

    def densify(
        self,
        step: int,
        parameters: Parameters,
        generator: torch.Generator,
        resting: Bool[Tensor, " n"] | None = None,
        most: int | None = None,
    ) -> Edit:
        """Clone, split and prune by the statistics so far, and forget them.

        Args:
            step: Number of the step, from 1.
            parameters: The model's tensors, as for `edits`.
            generator: Source of the children's positions.
            resting: Rows that are neither cloned nor split, whatever pulls at them; None: none.
            most: Most rows that it may lead to; None: as `most_after` says of the rows that are there.
        """
        every = self.settings.reset_interval
        fixed = None
        if len(self.gradient_sum) != len(parameters):  # no view was observed since
            self._clear(len(parameters), parameters.rows["means"].device)
        gradient, absolute = (
            total / self.seen.clamp(min=1) for total in (self.gradient_sum, self.absolute_sum)
        )
        if self.rules is not None:
            labelled = ~self.rules.growing(parameters)
            resting = labelled if resting is None else resting | labelled
            fixed = self.rules.fixed(parameters)
        if resting is not None:
            gradient[resting] = absolute[resting] = -1  # below any threshold
        most = self.most_after(step, len(parameters)) if most is None else most
        rows = densify(
            _shapes(parameters), gradient, replace(self.settings, most=most), extent=self.extent,
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
        self.gradient_sum = state["gradient_sum"].clone()
        self.absolute_sum = state["absolute_sum"].clone()
        self.seen = state["seen"].clone()


def _shapes(parameters: Parameters) -> Gaussians:
    """The rows without their colours, which density control does not look at."""
    rows = {name: value.detach() for name, value in parameters.rows.items()}
    return Gaussians(
        means=rows["means"], quaternions=rows["quaternions"], log_scales=rows["log_scales"],
        opacity_logits=rows["opacity_logits"], sh=rows["means"].new_zeros(len(rows["means"]), 1, 3),
    )  # fmt: skip
