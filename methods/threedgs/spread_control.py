"""Density control by what single pixels say: those whose opacity views disagree about are cloned and split."""

from collections.abc import Iterator

import torch

from splatproof.methods.contracts.density_strategy import Observation, Statistic
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
        """Start without statistics; none are needed between densifications.

        Args:
            settings: Steps of a 30,000 step run, shrunk to this one's; `most` is not None, its pace even.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            scorer: Renders views, by a backend that tallies fragments.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.needs: frozenset[Statistic] = frozenset()
        self.scorer = scorer

    def watches(self, step: int) -> bool:
        """Never: views are looked at when a densification comes.

        Args:
            step: Number of the step, from 1.
        """
        del step
        return False

    def observe(self, seen: Observation) -> None:
        """Nothing is noted."""
        del seen

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Look at views and densify, then reset opacities, each where its step has come.

        As many are drawn, without replacement, as `most_after` leaves room for. LiteGS adds as many as it
        removes, and a split leaves the parent there; here a drawn one is cloned or split as by strategy gradient.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, those of a GaussianModel.
            generator: Source of the views, of who grows and of the children's positions.

        Source: MooreThreads, "LiteGS", its release; views drawn anew in place of an epoch's: ours.
        """
        if self.densifies(step):
            splats, count = splats_of(parameters), len(parameters)
            most = self.most_after(step, count)
            assert most is not None
            views = self.scorer.drawn(step, splats, generator)
            tallies = torch.stack([self.scorer.tallied(view, splats) for view in views]).sum(dim=0)
            drawn = by_weight(spread(tallies).cpu(), max(0, most - count), generator)
            resting = torch.ones(count, dtype=torch.bool, device=splats.means.device)
            resting[drawn.to(resting.device)] = False
            # any pull above the threshold: who grows is drawn already
            self.gradient_sum = self.seen = torch.ones(count, device=splats.means.device)
            self.absolute_sum = torch.zeros(count, device=splats.means.device)
            yield self.densify(step, parameters, generator, resting, most)
        if self.resets(step):
            yield self.reset(parameters)
