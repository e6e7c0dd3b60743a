"""Density control that looks at errors of several views: who may grow, and where new Gaussians begin."""

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.models.gaussian_model import assemble
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.threedgs.insertion import inserted
from splatproof.methods.threedgs.scored_views import ScoredView, ViewScorer
from splatproof.methods.training.density_control import DensityControl
from splatproof.reference.density.multi_view_error import blame, importance, marked
from splatproof.reference.types.splats import Splats, activated


class ErrorControl(DensityControl):
    """Adaptive density control that renders training views before each densification."""

    def __init__(
        self, settings: StrategicDensity, *, iterations: int, extent: float, scorer: ViewScorer
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            scorer: Renders views.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.chosen, self.scorer = settings, scorer

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Look at views, insert, densify and remove, then reset opacities, each where its step has come.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, those of a GaussianModel.
            generator: Source of the views, of new places and of the children's positions.
        """
        if self.densifies(step):
            splats = splats_of(parameters)
            views = self.scorer.drawn(step, splats, generator)
            found = self.evidence(views, splats) if self.chosen.strategy == "error" else None
            before = len(parameters)
            most = self.most_after(step, before)
            if self.chosen.insertion.share:
                yield from self.insert(views, parameters, generator, most)
            if found is None:
                yield self.densify(step, parameters, generator, most=most)
            else:
                found = torch.cat([found, found.new_zeros(len(found), len(parameters) - before)], 1)
                losses = found.new_tensor([view.loss for view in views])
                yield from self.gated(step, parameters, generator, found, losses, most)
        if self.resets(step):
            yield self.reset(parameters)

    def evidence(self, views: Sequence[ScoredView], splats: Splats) -> Float[Tensor, "v n"]:
        """Pixels with large errors that each Gaussian shows on in each view, in full-size pixels.

        Args:
            views: Rendered views, at least one.
            splats: What they show.
        """
        threshold = self.chosen.error.threshold
        return torch.stack([
            view.factor**2 * self.scorer.evidence(
                view.camera, splats, marked(view.image, view.truth, threshold, view.valid)
            )
            for view in views
        ])  # fmt: skip

    def gated(
        self,
        step: int,
        parameters: Parameters,
        generator: torch.Generator,
        found: Float[Tensor, "v n"],
        losses: Float[Tensor, " v"],
        most: int | None,
    ) -> Iterator[Edit]:
        """Densify what views agree on, then remove what they blame most; blame follows its rows.

        Args:
            step: Number of the step, from 1.
            parameters: The model's tensors.
            generator: Source of the children's positions.
            found: Evidence in each view.
            losses: Loss of each view.
            most: Most Gaussians afterwards; None: no bound.
        """
        rules = self.chosen.error
        resting = importance(found) <= rules.pixels
        edit = self.densify(step, parameters, generator, resting, most)
        yield edit
        if rules.blame == 1:
            return
        assert edit.parents is not None
        assert edit.fresh is not None
        gone = (blame(found, losses)[edit.parents] > rules.blame) & ~edit.fresh
        if gone.any() and not gone.all():
            yield Edit(parents=torch.where(~gone)[0])

    def insert(
        self,
        views: Sequence[ScoredView],
        parameters: Parameters,
        generator: torch.Generator,
        most: int | None,
    ) -> Iterator[Edit]:
        """Add Gaussians where photos show errors, as far as `most` allows; their statistics are 0.

        Args:
            views: Rendered views.
            parameters: The model's tensors.
            generator: Source of the pixels.
            most: Most Gaussians afterwards; None: no bound.
        """
        rules, count = self.chosen.insertion, len(parameters)
        wanted = round(rules.share * count)
        wanted = wanted if most is None else min(wanted, max(0, most - count))
        made = inserted(views, wanted, size=rules.size, opacity=rules.opacity, generator=generator)
        added = len(made["means"])
        if not added:
            return
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        values = {}
        for name, value in rows.items():
            new = made.get(name, value.new_zeros(added, *value.shape[1:]))
            values[name] = torch.cat([value, new.to(value)])
        old = torch.arange(count, device=rows["means"].device)
        fresh = torch.arange(count + added, device=old.device) >= count
        if len(self.gradient_sum) == count:
            self.gradient_sum, self.absolute_sum, self.seen = (
                torch.cat([total, total.new_zeros(added)])
                for total in (self.gradient_sum, self.absolute_sum, self.seen)
            )
        yield Edit(parents=torch.cat([old, old.new_zeros(added)]), fresh=fresh, values=values)


def splats_of(parameters: Parameters) -> Splats:
    """The Gaussians as they are drawn after training, without gradients.

    Args:
        parameters: The tensors of a GaussianModel.
    """
    rows = {name: value.detach() for name, value in parameters.rows.items()}
    degree = round((rows["sh_rest"].shape[1] + 1) ** 0.5) - 1
    return activated(assemble(rows, degree))
