"""Density control in space and time: Gaussians are cloned and split by where and when they are pulled."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.dynamic.smoothing import average_velocities
from splatproof.methods.pvg.model import spans
from splatproof.methods.pvg.settings import Motion, MovingDensity
from splatproof.methods.training.density import SPLIT_SHRINK
from splatproof.methods.training.density_control import DensityControl


class MovingControl(DensityControl):
    """Density control as for 3dgs, whose split Gaussians spread over their life, and control in time.

    Source: the release of PVG. Of the gradient by the life peak it compares the signed mean when it
    splits and its size when it clones; here both compare the size. Its limits on sizes grow with the
    distance from the middle of the scene; here they are those of 3dgs.
    """

    def __init__(
        self,
        settings: MovingDensity,
        *,
        iterations: int,
        extent: float,
        parameters: Parameters,
        motion: Motion,
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            parameters: The model's tensors: the gradient by the life peaks is read where a step
                leaves it.
            motion: Decay and period of the average velocity.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.time, self.motion, self.parameters = settings, motion, parameters
        self.peak_sum = torch.zeros(0)

    def observe(self, seen: Observation) -> None:
        """Add one view: gradients by the 2D means and by the life peaks.

        Args:
            seen: What the view says.
        """
        super().observe(seen)
        gradient = self.parameters.rows["peaks"].grad
        if gradient is not None:
            self.peak_sum += gradient

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Densify in space, then in time; then reset opacities; each where its step has come.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors.
            generator: Source of the children's places and moments.
        """
        if self.densifies(step):
            if len(self.peak_sum) != len(parameters):  # no view was observed since
                self._clear(len(parameters), parameters.rows["means"].device)
            pulled = self.peak_sum.abs() / self.seen.clamp(min=1) >= self.time.time_gradient
            most = self.most_after(step, len(parameters))
            in_space = self.densify(step, parameters, generator, most=most)
            yield self._spread(in_space, parameters, generator)
            assert in_space.parents is not None
            assert in_space.fresh is not None
            chosen = pulled[in_space.parents] & ~in_space.fresh
            if bool(chosen.any()):
                shorter = step >= self.time.time_split * self.settings.stop
                chosen = within(chosen, most)
                yield self.in_time(chosen, parameters, generator, shorter=shorter)
            self._clear(len(parameters), chosen.device)
        if self.resets(step):
            yield self.reset(parameters)

    def _spread(self, edit: Edit, parameters: Parameters, generator: torch.Generator) -> Edit:
        """The same edit, with the children of a split at other moments of their parent's life."""
        assert edit.parents is not None
        assert edit.fresh is not None
        before = parameters.rows["log_scales"].detach()[edit.parents]
        children = edit.fresh & (edit.values["log_scales"] != before).any(dim=1)
        rows = {name: value.detach()[edit.parents] for name, value in parameters.rows.items()}
        rows["means"] = edit.values["means"]
        return replace(edit, values={**edit.values, **self.spread(rows, children, generator)})

    def spread(
        self, rows: dict[str, Tensor], children: Bool[Tensor, " n"], generator: torch.Generator
    ) -> dict[str, Tensor]:
        """Means and peaks after some Gaussians went to another moment: tau + d, x + v d, d ~ N(0, beta).

        The velocity is the average one, and no moment is further than the period from the peak.

        Args:
            rows: Tensors of all Gaussians.
            children: Those that go.
            generator: Source of d.
        """
        index = torch.where(children)[0]
        own = {name: value[index] for name, value in rows.items()}
        draw = torch.randn(len(index), generator=generator).to(own["peaks"])
        away = draw * spans(own).clamp(max=self.motion.period)
        means, peaks = rows["means"].clone(), rows["peaks"].clone()
        slow = average_velocities(
            own["velocities"], spans(own), self.motion.period, self.motion.decay
        )
        means[index] += slow * away[:, None]
        peaks[index] += away
        return {"means": means, "peaks": peaks}

    def in_time(
        self,
        chosen: Bool[Tensor, " n"],
        parameters: Parameters,
        generator: torch.Generator,
        *,
        shorter: bool,
    ) -> Edit:
        """Clone Gaussians of short life, split those of long life into moments of it.

        Args:
            chosen: Those that are pulled in time and may grow.
            parameters: The model's tensors.
            generator: Source of the moments.
            shorter: Whether three children live 1 / 1.6 as long, rather than two as long as before.
        """
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        long = spans(rows) > self.time.least_span
        split = torch.where(chosen & long)[0].repeat(3 if shorter else 2)
        clone = torch.where(chosen & ~long)[0]
        keep = torch.where(~(chosen & long))[0]
        parents: Int[Tensor, " m"] = torch.cat([keep, clone, split])
        children = torch.arange(len(parents), device=parents.device) >= len(keep) + len(clone)
        new = {name: value[parents] for name, value in rows.items()}
        values = self.spread(new, children, generator)
        log_spans: Float[Tensor, " m"] = new["log_spans"]
        if shorter:
            log_spans = log_spans - children.to(log_spans) * math.log(SPLIT_SHRINK)
        fresh = torch.arange(len(parents), device=parents.device) >= len(keep)
        return Edit(parents=parents, fresh=fresh, values={**values, "log_spans": log_spans})

    def _clear(self, count: int, device: torch.device) -> None:
        """Forget the statistics."""
        super()._clear(count, device)
        self.peak_sum = torch.zeros(count, device=device)

    def state(self) -> dict[str, Tensor]:
        """The statistics as named tensors."""
        return super().state() | {"peak_sum": self.peak_sum}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        super().restore(state)
        self.peak_sum = state["peak_sum"].clone()


def within(chosen: Bool[Tensor, " n"], most: int | None) -> Bool[Tensor, " n"]:
    """The first of some Gaussians, as many as a bound on all lets become three each.

    Args:
        chosen: Those that are to be cloned or split in time.
        most: Most Gaussians afterwards; None: no bound.
    """
    if most is None:
        return chosen
    return chosen & (chosen.cumsum(0) <= max(0, most - len(chosen)) // 2)
