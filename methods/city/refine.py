"""Global consistency refinement: one look for all blocks, trained through the 8 bits it is stored in."""

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from jaxtyping import Bool
from torch import Tensor

from splatproof.methods.backends import get_backend
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import loop as training
from splatproof.methods.training.density import Density
from splatproof.methods.training.schedules import Rates, require
from splatproof.reference.compression.affine_codes import fake_quantise, lattice
from splatproof.reference.stitching.preclean import CleanSettings, preclean
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

PAPER_SHARE = 7_000 / 40_000
"""Refinement steps a step of block training in the paper."""
MOMENTUM = 0.9
"""Of the release's SGD."""
APPEARANCE = ("sh_dc", "sh_rest", "opacity")
"""What is fitted; means, quaternions and scales are frozen."""


@dataclass(frozen=True, kw_only=True)
class RefineSettings:
    """How a merged model is cleaned and its appearance fitted over all views."""

    iterations: int | None = None
    """Steps; None: 7 for 40 steps of block training, as in the paper."""
    quantise_from: float = 0.1
    """Share of the steps after which the residual harmonics are seen through 8 bits; 1: never."""
    optimizer: Literal["adam", "sgd"] = "adam"
    """sgd: with momentum 0.9 and the rates below, as released."""
    sh_dc: float = 2.5e-3
    """Rate of the constant SH band."""
    sh_rest: float = 1.25e-4
    """Rate of the residual harmonics (release: 2.5e-4, with SGD)."""
    opacity: float = 0.025
    """Rate of opacity logits (release: 0.05, with SGD)."""
    settle: float = 0.1
    """Factor on the rates at the last step, reached from the middle on."""
    clean: CleanSettings = field(default_factory=lambda: CleanSettings(volume_quantile=1.0))
    """What is thrown away first. The paper also drops the 0.1 % of largest volume; in a scene with
    sky or sea those few are the background, and the refinement, which moves nothing, cannot mend it
    (brighton_beach: 23 of 22,664 Gaussians, 6.6 dB on the training views)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        steps = self.iterations
        require(steps is None or steps >= 1, "refine.iterations", steps, ">= 1 or None")
        require(0 <= self.quantise_from <= 1, "refine.quantise_from", self.quantise_from, "0 to 1")
        for name in ("sh_dc", "sh_rest", "opacity", "settle"):
            value = getattr(self, name)
            require(value >= 0, f"refine.{name}", value, ">= 0")

    def steps(self, block_iterations: int) -> int:
        """Steps of the refinement after blocks of so many."""
        return self.iterations or max(1, round(PAPER_SHARE * block_iterations))


def clean(model: Gaussians, settings: CleanSettings) -> Bool[Tensor, " n"]:
    """Which Gaussians stay: visible, of finite size, not among the largest.

    Source: StitchGS, Sec. 3.2.4.
    """
    return preclean(model.opacity_logits, model.log_scales, settings)


def refine(
    model: Gaussians,
    scene: Scene,
    settings: RefineSettings,
    base: Settings,
    run: Run,
    folder: Path | None,
) -> tuple[Gaussians, float]:
    """Fit opacity and colour of a merged model to all training views; geometry stays as it is.

    Args:
        model: Already cleaned.
        scene: With all training views.
        settings: Steps and rates.
        base: Of the blocks: loss, background and SH degree.
        run: Seed, backend and reports.
        folder: Of its checkpoint; None: none is kept.

    Returns: The refined model and the seconds it took, those before an interruption included.

    Source: StitchGS, Sec. 3.2.4; Adam instead of SGD: ours.
    """
    rates = Rates(
        means=0.0, means_final=0.0, scales=0.0, quaternions=0.0, sh_dc=settings.sh_dc,
        sh_rest=settings.sh_rest, opacity=settings.opacity, settle=settings.settle,
    )  # fmt: skip
    own = replace(
        base, iterations=settings.steps(base.iterations), rates=rates, sh_interval=0,
        density=Density(stop=0, reset_interval=0),
    )  # fmt: skip
    trainer = Refiner(model, scene, settings, own, replace(run, folder=folder))
    trainer.resume()
    trainer.train()
    found = trainer.gaussians()
    frozen = {name: getattr(model, name) for name in ("means", "quaternions", "log_scales")}
    return replace(found, **frozen), trainer.seconds


class Refiner(training.Trainer):
    """Training of appearance only, through 8-bit residual harmonics."""

    renders_parameters = False

    def __init__(
        self,
        model: Gaussians,
        scene: Scene,
        settings: RefineSettings,
        own: Settings,
        run: Run,
    ) -> None:
        """Start from a merged model."""
        digest = hashlib.sha256()
        for name in FIELDS:
            digest.update(getattr(model, name).detach().contiguous().numpy())
        special = f"{settings} {digest.hexdigest()}"
        backend = get_backend(run.backend)
        super().__init__(scene, own, run, backend, start=model, special=special)
        self.refinement = settings

    def model(self, degree: int) -> Gaussians:
        """The Gaussians as they will be stored: residual harmonics on their lattice of 256 values."""
        leaves = self.adam.leaves()
        if self.step > self.refinement.quantise_from * self.settings.iterations:
            rest = leaves["sh_rest"].flatten(start_dim=1)
            low, reach = lattice(rest.detach())
            leaves["sh_rest"] = fake_quantise(rest, low, reach).reshape_as(leaves["sh_rest"])
        return training.assemble(leaves, degree)

    def update(self) -> None:
        """Follow the gradients of the appearance; what is frozen has no say."""
        parameters = self.adam.parameters
        for name, value in parameters.items():
            if name not in APPEARANCE:
                value.grad = None
        if self.refinement.optimizer == "adam":
            super().update()
            return
        rates = self.learning_rates()
        for name in APPEARANCE:
            gradient = parameters[name].grad
            if gradient is not None:
                self.adam.first[name].mul_(MOMENTUM).add_(gradient)
                parameters[name].detach().sub_(rates[name] * self.adam.first[name])
                parameters[name].grad = None
