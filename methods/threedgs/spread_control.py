"""Density control by what single pixels say: those whose opacity they disagree about are cloned and split."""

from collections.abc import Iterator

import torch

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.threedgs.error_control import splats_of
from splatproof.methods.threedgs.insertion import by_weight
from splatproof.methods.threedgs.scored_views import ViewScorer
from splatproof.methods.training.density_control import DensityControl
from splatproof.reference.density.opacity_spread import spread


class SpreadControl(DensityControl):
    """Adaptive density control that draws who grows by the spread of opacity gradients."""

    def __init__(
        self, settings: StrategicDensity, *, iterations: int, extent: float, scorer: ViewScorer
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            scorer: Renders views, by a backend that tallies fragments.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.scorer = scorer

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Look at views and densify, then reset opacities, each where its step has come.

        As many are drawn, without replacement, as the loss pulls at, and as there is room for. In LiteGS a
        number that grows evenly says how many, as a threshold of 0 and an even pace do here, and a split leaves
        the parent there; here a drawn one is cloned or split as by strategy gradient.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, those of a GaussianModel.
            generator: Source of the views, of who grows and of the children's positions.

        Source: MooreThreads, "LiteGS", its release; how many grow, and views drawn anew in place of an epoch's:
            ours.
        """
        if self.densifies(step):
            splats, count = splats_of(parameters), len(parameters)
            most = self.most_after(step, count)
            wanted = self.pulled(count)
            wanted = wanted if most is None else min(wanted, max(0, most - count))
            views = self.scorer.chosen(generator)
            looked = [self.scorer.tallied(step, view, splats) for view in views]
            tallies = torch.stack(looked).sum(dim=0)
            drawn = by_weight(spread(tallies).cpu(), wanted, generator)
            resting = torch.ones(count, dtype=torch.bool, device=splats.means.device)
            resting[drawn.to(resting.device)] = False
            # those that are drawn are pulled at by more than the threshold, and nobody else is
            self.gradient_sum = torch.full_like(splats.opacities, 1 + self.settings.gradient)
            self.absolute_sum, self.seen = (
                torch.zeros_like(splats.opacities),
                torch.ones_like(splats.opacities),
            )
            yield self.densify(step, parameters, generator, resting, most)
        if self.resets(step):
            yield self.reset(parameters)

    def pulled(self, count: int) -> int:
        """How many rows the loss has pulled at by the threshold or more since the last densification.

        Args:
            count: Rows of the model; statistics of another number are none.
        """
        if len(self.gradient_sum) != count:
            return 0
        gradient = self.gradient_sum / self.seen.clamp(min=1)
        return int((gradient >= self.settings.gradient).sum())
