"""Training of a finished model through the very steps that its small file will have."""

import hashlib
from dataclasses import asdict, dataclass, field

import torch
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Frozen
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.models.gaussian_model import GaussianModel, assemble
from splatproof.methods.storage.packed.coded_chunk import quantise, restore
from splatproof.methods.storage.packed.straight_through import rate, stored
from splatproof.methods.training.initialise import extent
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates, require
from splatproof.methods.training.session import run_key
from splatproof.methods.training.terms import ParameterTerm, Photometric
from splatproof.reference.compression import quantisers
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene


@dataclass(frozen=True, kw_only=True)
class TuneSettings:
    """How a finished model is trained through the steps of its file."""

    iterations: int = 300
    """Number of steps, each on one view."""
    rate: float = 1e-3
    """Weight in the loss of a bit that the harmonics of a Gaussian take on average; 0: none."""
    rates: Rates = field(
        default_factory=lambda: Rates(
            means=1.6e-5, means_final=1.6e-6, sh_dc=1e-3, sh_rest=2.5e-4, opacity_logits=0.01,
            log_scales=2e-3, settle=0.1,
        )
    )  # fmt: skip
    """Learning rates of the Gaussians' parameters, chosen on views held out of the training photos of
    brighton_beach and courtyard: 2.5 times as large ones gain 0.06 dB on those trained on and
    lose 0.03 on the others, smaller ones gain less on both."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.iterations >= 1, "iterations", self.iterations, ">= 1")
        require(0 <= self.rate <= 1, "rate", self.rate, "0 to 1")


class CodedModel(GaussianModel):
    """Gaussians that are seen as a small file gives them back."""

    def __init__(
        self, start: Gaussians, steps: Steps, rates: Rates, *, extent: float, mode: Mode
    ) -> None:
        """Start from Gaussians that were on these steps once.

        Args:
            start: The Gaussians.
            steps: The file's.
            rates: Learning rates.
            extent: Size of the scene in scene units.
            mode: How they are rasterized.
        """
        super().__init__(start, rates, extent=extent, mode=mode)
        self.steps = steps

    def drawn_rows(self, moment: Moment) -> dict[str, Tensor]:
        """The rows on the file's steps.

        Args:
            moment: As for the base class.
        """
        return stored(super().drawn_rows(moment), self.steps)

    def gaussians(self) -> Gaussians:
        """The model as the file will give it back."""
        rows = {name: value.detach().cpu() for name, value in self.parameters.rows.items()}
        return assemble(stored(rows, self.steps), self.degree)


def tuned(
    model: Gaussians, scene: Scene, steps: Steps, settings: TuneSettings, run: Run, mode: Mode
) -> Gaussians:
    """Train a finished model on all training views, as its file will show it.

    Args:
        model: The model, thinned if it is to be.
        scene: The scene that it was trained on.
        steps: How finely the file stores it; they stay.
        settings: Steps of training, learning rates and the price of bits.
        run: Seed, backend, checkpoints and who is told.
        mode: How the model is rasterized.

    Returns: Gaussians on the file's steps: storing them loses nothing more.

    Raises: DataError for numbers beyond the file's grid; UsageError if a checkpoint belongs to another
        run.

    Source: ours; straight-through quantisation as in StitchGS, Sec. 3.2.4.
    """
    corner = quantisers.cells(model.means.double().numpy(), steps.position).min(axis=0)
    start = restore(quantise(model, steps, corner), steps, corner)
    size = extent(scene)
    fitted = CodedModel(start, steps, settings.rates, extent=size, mode=mode)
    terms = (Photometric(), bits(steps, settings.rate)) if settings.rate else (Photometric(),)
    plan = Plan(
        steps=settings.iterations, views=scene.train_views, terms=terms, density=Frozen(),
        key=run_key(scene, settings, run, f"{asdict(steps)} {mode} {_digest(model)}"),
    )  # fmt: skip
    trainer = Trainer(fitted, plan, run)
    trainer.resume()
    trainer.train()
    return fitted.gaussians()


def bits(steps: Steps, weight: float) -> ParameterTerm:
    """The term weight * rate: harmonics become 0 where no photo misses them.

    Args:
        steps: The file's.
        weight: Factor, > 0.

    Source: ours, see straight_through.rate.
    """

    def add(parameters: Parameters) -> float:
        rest = parameters.rows["sh_rest"]
        own = rest.detach().requires_grad_()
        with torch.enable_grad():
            value = weight * rate(dict(parameters.rows) | {"sh_rest": own}, steps)
        if rest.grad is not None:
            rest.grad += torch.autograd.grad(value, own)[0]
        return float(value.detach())

    return ParameterTerm(name="bits", add=add)


def _digest(model: Gaussians) -> str:
    digest = hashlib.sha256()
    for name in FIELDS:
        digest.update(getattr(model, name).detach().contiguous().numpy())
    return digest.hexdigest()
