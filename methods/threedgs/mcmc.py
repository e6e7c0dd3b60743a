"""Density control of 3DGS-MCMC: nothing is removed; what is transparent moves, and everything is shaken."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Frozen
from splatproof.methods.contracts.model import Schedule
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.training.density_control import densifies, shrunk
from splatproof.reference.density.relocation import nudges, stacked
from splatproof.reference.rasterizer.rotation import covariance, half_covariance

SHUT = 0.1
"""Opacity from which on nothing is shaken: the gate on noise is below 1e-4 there, and time is saved."""


class McmcControl(Frozen):
    """Relocation, growth by a share and noise; it needs no statistics, so it keeps nothing between steps."""

    def __init__(
        self, settings: StrategicDensity, *, iterations: int, extent: float, rate: Schedule
    ) -> None:
        """Take the settings of a run of some length.

        Args:
            settings: Steps of a 30,000 step run, shrunk to this one's; `most` is not None.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
            rate: Learning rate of positions in scene units, by step and number of steps: noise falls
                with it.
        """
        self.settings, self.iterations = shrunk(settings, iterations), iterations
        self.extent, self.rate = extent, rate

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Shake positions; where its step has come, move what is dead and grow.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, those of a GaussianModel.
            generator: Source of the noise and of who is copied.

        Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Sec. 4. Lengths
            are in extents here, so that noise does not depend on the unit: ours.
        """
        if self.settings.mcmc.noise:
            yield self.shake(step, parameters, generator)
        if densifies(self.settings, step):
            yield from self.relocate(parameters, generator)
            yield from self.grow(parameters, generator)

    def shake(self, step: int, parameters: Parameters, generator: torch.Generator) -> Edit:
        """Move positions by noise * rate * Sigma xi, gated by opacity, lengths in extents.

        Those of opacity 0.1 and more stay: the gate would let a ten thousandth through.

        Args:
            step: Number of the step, from 1.
            parameters: The model's tensors.
            generator: Source of xi.
        """
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        opacities = rows["opacity_logits"].sigmoid()
        (loose,) = torch.where(opacities < SHUT)
        draws = torch.randn(len(loose), 3, generator=generator).to(rows["means"])
        sigma = covariance(rows["quaternions"][loose], rows["log_scales"][loose].exp())
        # rate / extent is the rate in extents, Sigma / extent^2 the covariance, and extent the way back
        strength = self.settings.mcmc.noise * self.rate(step, self.iterations) / self.extent**2
        moved = strength * nudges(sigma, opacities[loose], draws)
        return Edit(values={"means": rows["means"].index_add(0, loose, moved)})

    def relocate(self, parameters: Parameters, generator: torch.Generator) -> Iterator[Edit]:
        """Move Gaussians that are no more opaque than `least_opacity` onto others, drawn by opacity.

        Nothing happens where none or all are dead. Moments of those moved onto start at zero; those that
        move keep theirs, as in the release.

        Args:
            parameters: The model's tensors.
            generator: Source of the draw.
        """
        opacities = parameters.rows["opacity_logits"].detach().sigmoid()
        dead = opacities <= self.settings.least_opacity
        if not dead.any() or dead.all():
            return
        onto = drawn(opacities.where(~dead, 0), int(dead.sum()), generator)
        source = torch.arange(len(opacities), device=dead.device)
        parents = source.clone()
        source[dead] = onto
        fresh = torch.zeros_like(dead)
        fresh[onto] = True
        values = self._stacks(parameters, source, torch.where(dead)[0], generator)
        yield Edit(parents=parents, fresh=fresh, values=values)

    def grow(self, parameters: Parameters, generator: torch.Generator) -> Iterator[Edit]:
        """Copy Gaussians drawn by opacity, until there are 1 + growth times as many or `most`.

        Args:
            parameters: The model's tensors.
            generator: Source of the draw.
        """
        count, most = len(parameters), self.settings.most
        assert most is not None
        added = min(most, int((1 + self.settings.mcmc.growth) * count)) - count
        if added <= 0:
            return
        opacities = parameters.rows["opacity_logits"].detach().sigmoid()
        of = drawn(opacities, added, generator)
        rows = torch.arange(count + added, device=of.device)
        parents = torch.cat([rows[:count], of])
        fresh = rows >= count
        fresh[of] = True
        values = self._stacks(parameters, parents, rows[count:], generator)
        yield Edit(parents=parents, fresh=fresh, values=values)

    def _stacks(
        self,
        parameters: Parameters,
        source: Int[Tensor, " m"],
        copied: Int[Tensor, " k"],
        generator: torch.Generator,
    ) -> dict[str, Tensor]:
        """All tensors with each row that of its source; sources that have several rows are shared out."""
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        values = {name: value[source] for name, value in rows.items()}
        copies = source.bincount(minlength=len(parameters))[source]
        several = copies > 1
        opacities, scales = stacked(
            values["opacity_logits"][several].double().sigmoid(),
            values["log_scales"][several].double().exp(),
            copies[several],
            least=self.settings.least_opacity,
        )
        values["opacity_logits"][several] = opacities.logit().to(values["opacity_logits"])
        values["log_scales"][several] = scales.log().to(values["log_scales"])
        if self.settings.mcmc.spread:
            half = half_covariance(
                values["quaternions"][copied], values["log_scales"][copied].exp()
            )
            draws = torch.randn(len(copied), 3, 1, generator=generator).to(half)
            values["means"][copied] += self.settings.mcmc.spread * (half @ draws)[:, :, 0]
        return values


def drawn(
    weights: Float[Tensor, " n"], count: int, generator: torch.Generator
) -> Int[Tensor, " k"]:
    """Indices drawn with replacement, each in proportion to its weight; of any number of them.

    Args:
        weights: Weights >= 0, at least one above.
        count: Number of draws.
        generator: Source of the draws.
    """
    ends = weights.cpu().double().cumsum(dim=0)  # torch.multinomial takes 2^24 at most
    places = torch.rand(count, generator=generator, dtype=torch.float64) * ends[-1]
    found = torch.searchsorted(ends, places, right=True)
    return found.clamp(max=int((weights > 0).nonzero()[-1])).to(weights.device)
