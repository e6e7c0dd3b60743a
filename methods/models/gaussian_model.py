"""Explicit Gaussians while they are trained: the model of 3dgs, of its relatives and of blocks."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.methods.contracts.model import Model, Moment, NativeTensors
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.regularisers import draw_shown, thinned
from splatproof.methods.training.schedules import Rates, active_degree, log_linear, settling
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats, activated


class GaussianModel(Model):
    """Gaussians whose raw values are the trained tensors and nothing else."""

    def __init__(
        self,
        start: Gaussians,
        rates: Rates,
        *,
        extent: float,
        mode: Mode = "classic",
        sh_every: float = 0.0,
        dropout: float = 0.0,
        labels: Mapping[str, Tensor] | None = None,
    ) -> None:
        """Start from some Gaussians.

        Args:
            start: Their raw values; their harmonics' degree is the highest that is trained.
            rates: Learning rates; a tensor whose rates are all 0 is frozen.
            extent: Size of the scene in scene units, which positions move in proportion to.
            mode: How they are rasterized.
            sh_every: Steps until one more band of harmonics is drawn; 0: all from the start.
            dropout: Share of Gaussians hidden at the last step, growing linearly from 0.
            labels: What each row is labelled with, by the name of the label (see Parameters); None:
                nothing.
        """
        rows = {
            "means": start.means, "sh_dc": start.sh[:, :1], "sh_rest": start.sh[:, 1:],
            "opacity_logits": start.opacity_logits, "log_scales": start.log_scales,
            "quaternions": start.quaternions,
        }  # fmt: skip
        moving = {"means": log_linear(rates.means, rates.means_final, factor=extent)} | {
            name: settling(getattr(rates, name), rates.settle)
            for name in ("sh_dc", "sh_rest", "opacity_logits", "log_scales", "quaternions")
        }
        frozen = {name for name in moving if getattr(rates, name) == 0}
        super().__init__(
            Parameters(rows, labels=labels),
            {name: schedule for name, schedule in moving.items() if name not in frozen},
        )
        self.mode: Mode = mode
        self.degree, self.sh_every, self.dropout = start.degree, sh_every, dropout

    def gaussians(self) -> Gaussians:
        """The model as it is now, on the CPU, without gradients."""
        values = {name: value.detach().cpu() for name, value in self.parameters.rows.items()}
        return assemble(values, self.degree)

    def drawn_degree(self, moment: Moment) -> int:
        """Degree of the harmonics that are drawn at a moment.

        Args:
            moment: Step of training, or TRAINED.
        """
        if not moment.trains:
            return self.degree
        return active_degree(moment.step, self.sh_every, self.degree)

    def drawn_rows(self, moment: Moment) -> dict[str, Tensor]:
        """The trained tensors as they are drawn; a model that stores them otherwise overrides it.

        Args:
            moment: Step of training, or TRAINED.
        """
        rows = dict(self.parameters.rows)
        if (found := self.stored_harmonics(moment)) is not None:
            values, kept = found
            rest = rows["sh_rest"]
            rows["sh_rest"] = values + torch.where(kept, rest - rest.detach(), 0)
        return rows

    def stored_harmonics(
        self, moment: Moment
    ) -> tuple[Float[Tensor, "n r 3"], Bool[Tensor, "n 1 1"]] | None:
        """View-dependent colour as a file gives it back, where a model is trained through that.

        Args:
            moment: Step of training, or TRAINED.

        Returns: The values, without gradient, and of which rows they are the rounded ones: those get the
            gradient by their values, the others none. None: what is trained is drawn.
        """
        del moment
        return None

    def splats(self, view: View, moment: Moment) -> Splats:
        """The Gaussians, activated; a share of them is hidden while training, if so set.

        Args:
            view: Not looked at.
            moment: Says how many bands of harmonics are drawn and how many Gaussians are hidden.
        """
        del view
        rows = self.drawn_rows(moment)
        rows["opacity_logits"] = self._thin(rows["opacity_logits"], moment)
        return activated(assemble(rows, self.drawn_degree(moment)))

    def native(self, view: View, moment: Moment) -> NativeTensors | None:
        """The trained tensors, where they are on the CPU and drawn as they are but for stored harmonics.

        Args:
            view: Not looked at.
            moment: As for `splats`.
        """
        del view
        rows = self.parameters.rows
        kind = type(self)
        as_they_are = kind.splats is GaussianModel.splats and (
            kind.drawn_rows is GaussianModel.drawn_rows
        )
        if not as_they_are or any(value.device.type != "cpu" for value in rows.values()):
            return None
        own = rows["opacity_logits"].detach().requires_grad_()
        drawn = self._thin(own, moment)
        stored = self.stored_harmonics(moment)
        seen = rows | {"opacity_logits": drawn} | ({"sh_rest": stored[0]} if stored else {})

        def leave(gradients: Mapping[str, Tensor]) -> None:
            for name, gradient in gradients.items():
                if name in self.schedules:
                    rows[name].grad = gradient
            if stored and rows["sh_rest"].grad is not None:
                rows["sh_rest"].grad.mul_(stored[1])
            if drawn is not own and "opacity_logits" in self.schedules:
                # as grad(drawn, own, given), for which torch imports a whole algebra system: a second
                total = (drawn * gradients["opacity_logits"]).sum()
                rows["opacity_logits"].grad = torch.autograd.grad(total, own)[0]

        return NativeTensors(tensors=seen, degree=self.drawn_degree(moment), leave=leave)

    def _thin(self, logits: Tensor, moment: Moment) -> Tensor:
        """The opacity logits that one step draws."""
        share = self.dropout * moment.step / moment.total
        if share == 0 or moment.generator is None:
            return logits
        shown = draw_shown(len(logits), share, moment.generator).to(logits.device)
        return thinned(logits, shown, share)


def assemble(values: Mapping[str, Tensor], degree: int) -> Gaussians:
    """Gaussians of the trained tensors, with the SH bands up to a degree.

    Args:
        values: Tensors means, quaternions, log_scales, opacity_logits, sh_dc and sh_rest.
        degree: Highest degree that is kept, 0 to 3.
    """
    rest = values["sh_rest"][:, : (degree + 1) ** 2 - 1]
    return Gaussians(
        means=values["means"], quaternions=values["quaternions"], log_scales=values["log_scales"],
        opacity_logits=values["opacity_logits"], sh=torch.cat([values["sh_dc"], rest], dim=1),
    )  # fmt: skip
