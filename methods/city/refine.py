"""Global consistency refinement: one look for all blocks, trained through the file that it is stored in."""

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Frozen
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.models.exposure import exposed
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.storage.packed.straight_through import stored_harmonics
from splatproof.methods.storage.packed.writer import FileSettings
from splatproof.methods.threedgs.fit import terms
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.initialise import extent
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.optimizer import Adam, Momentum
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates, require
from splatproof.methods.training.session import run_key
from splatproof.reference.compression.affine_codes import STEPS, lattice
from splatproof.reference.compression.quantisers import MOST_LOGIT, Steps
from splatproof.reference.compression.spectral import open_gate
from splatproof.reference.stitching.preclean import CleanSettings, preclean
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

PAPER_SHARE = 7_000 / 40_000
"""Number of refinement steps for each step of block training in the paper."""
FIRST = 0.1
"""First rate of positions that move in the refinement, as a share of that in the blocks' training."""
GEOMETRY = ("means", "log_scales", "quaternions")
NO_BOUND = 1e9
"""Length in scene units that no Gaussian has: a record of settings holds numbers, and no infinite ones."""


@dataclass(frozen=True, kw_only=True)
class RefineSettings:
    """How a merged model is cleaned and its appearance fitted over all views."""

    iterations: int | None = None
    """Steps of the refinement; None: 7 for every 40 steps of block training, as in the paper, and as
    many as `visits` asks for."""
    visits: int = 4
    """Fewest times that every training view is visited where `iterations` is None."""
    quantise_from: float = 0.1
    """Share of the steps, 0 to 1, after which view-dependent colour is seen through the 8 bits (or on
    the steps of our file) that it will be stored in; 1: never."""
    optimizer: Literal["adam", "sgd"] = "adam"
    """What follows the gradients. adam: ours; sgd: gradient descent with momentum 0.9, as
    released."""
    sh_dc: float = 2.5e-3
    """Learning rate of colour that is the same from all sides (SH band 0)."""
    sh_rest: float = 1.25e-4
    """Learning rate of view-dependent colour (all higher SH bands; the release: 2.5e-4, with
    SGD)."""
    opacity: float = 0.025
    """Learning rate of opacity logits (the release: 0.05, with SGD)."""
    walls: float = 0.0
    """Half the width of the strip along the walls of blocks, in normalised distance, in which positions,
    scales and rotations are fitted too: what two blocks have put on one place sorts itself out there.
    0: nowhere, as in the paper."""
    level: bool = False
    """Whether each block's colours are first brought to the photos' level, by three factors in closed form (ours):
    light that differs from block to block is gone before a gradient is taken, and what is fitted is left the rest."""
    parts: bool = False
    """Whether each block's part of the model is refined apart, and by whom blocks are trained apart: on the
    block's own views, with all that these show (ours). Of what several parts show the mean is kept; geometry is left to
    the part whose block owns it. False: all at once, as in the paper, which one machine has to hold."""
    settle: float = 0.1
    """Factor on these rates at the last step, reached log-linearly from the middle of the
    refinement on; 1: constant."""
    clean: CleanSettings = field(
        default_factory=lambda: CleanSettings(volume_quantile=1.0, largest_scale=NO_BOUND)
    )
    """What is thrown away first. The paper also drops the 0.1 % of largest volume; in a scene with
    sky or sea those few are the background, and the refinement, which moves nothing, cannot mend it
    (brighton_beach: 23 of 22,664 Gaussians, 6.6 dB on the training views). And it drops what is longer than
    50 scene units, which in a world in metres are river and lawn (city/medium: 112 of 597,251)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        steps = self.iterations
        require(steps is None or steps >= 1, "refine.iterations", steps, ">= 1 or None")
        require(self.visits >= 0, "refine.visits", self.visits, ">= 0")
        require(0 <= self.quantise_from <= 1, "refine.quantise_from", self.quantise_from, "0 to 1")
        for name in ("sh_dc", "sh_rest", "opacity", "settle", "walls"):
            value = getattr(self, name)
            require(value >= 0, f"refine.{name}", value, ">= 0")

    def steps(self, base: Settings, views: int, part: int | None = None) -> int:
        """Number of steps of the refinement, or of a part of it that visits its views as often.

        Args:
            base: Settings that each block was trained with; steps and views a step count.
            views: Number of training views of the whole scene.
            part: Number of those that the part has; None: all.
        """
        seen = views if part is None else part
        whole = PAPER_SHARE * base.iterations if self.iterations is None else self.iterations
        fewest = 0 if self.iterations is not None else -(-self.visits * seen // base.views_per_step)
        return max(1, round(whole * seen / views), fewest)


def clean(model: Gaussians, settings: CleanSettings) -> Bool[Tensor, " n"]:
    """Which Gaussians stay: visible, of finite size, not among the largest.

    Args:
        model: The merged model.
        settings: Thresholds.

    Source: StitchGS, Sec. 3.2.4.
    """
    return preclean(model.opacity_logits, model.log_scales, settings)


class Refined(NamedTuple):
    """A refined model, and what it cost, before an interruption too."""

    model: Gaussians
    seconds: float
    """Wall seconds."""
    cpu_seconds: float
    """Processor seconds, over all threads."""


def refine(
    model: Gaussians,
    scene: Scene,
    settings: RefineSettings,
    base: Settings,
    run: Run,
    folder: Path | None,
    pack: FileSettings | Steps | None = None,
    moving: Bool[Tensor, " n"] | None = None,
    steps: int | None = None,
) -> Refined:
    """Fit opacity and colour of a merged model to all training views; elsewhere geometry stays as it is.

    Args:
        model: The merged model, already cleaned.
        scene: The whole scene, with all training views.
        settings: Steps and rates.
        base: Settings that the blocks were trained with; loss, steps, views a step, background,
            exposure, mode and dropout count.
        run: Seed, backend and reports.
        folder: Where its checkpoint goes; None: none is kept.
        pack: How the model will be stored: what the gate of the paper's file drops is not seen in
            training either, and of our file the steps are. None: nothing is dropped, and harmonics are
            seen as the paper's file has them.
        moving: Gaussians whose positions, scales and rotations are fitted too; None: none are. Positions
            start at a tenth of the blocks' first rate and end at their last, the others have the blocks'.
        steps: Number of steps; None: those that the settings ask for over these views.

    Source: StitchGS, Sec. 3.2.4; Adam instead of SGD, and what moves: ours.
    """
    of_blocks, any_moves = base.rates, moving is not None and bool(moving.any())
    rates = Rates(
        means=of_blocks.means * FIRST if any_moves else 0.0,
        means_final=of_blocks.means_final if any_moves else 0.0,
        log_scales=of_blocks.log_scales if any_moves else 0.0,
        quaternions=of_blocks.quaternions if any_moves else 0.0,
        sh_dc=settings.sh_dc, sh_rest=settings.sh_rest, opacity_logits=settings.opacity,
        settle=settings.settle,
    )  # fmt: skip
    steps = steps or settings.steps(base, len(scene.train))
    size = extent(scene) if any_moves else 0.0
    fitted = QuantisedModel(model, rates, settings.quantise_from, base, pack, extent=size)
    still = None if moving is None or not any_moves else (~moving).nonzero()[:, 0]
    plan = Plan(
        steps=steps,
        views=scene.train_views,
        terms=terms(base),
        density=Frozen(),
        key=run_key(scene, base, run, f"{settings} {pack} {_digest(model, moving)}"),
        views_per_step=base.views_per_step,
        random_background=base.random_background,
        optimizer=Momentum if settings.optimizer == "sgd" else Adam,
        held=None if still is None else lambda _: dict.fromkeys(GEOMETRY, still),
    )
    shown = exposed(fitted, base.exposure, plan.views)
    trainer = Trainer(shown, plan, replace(run, folder=folder))
    trainer.resume()
    trainer.train()
    return Refined(fitted.gaussians(), trainer.seconds, trainer.cpu_seconds)


def _digest(model: Gaussians, moving: Bool[Tensor, " n"] | None) -> str:
    digest = hashlib.sha256(b"" if moving is None else moving.numpy().tobytes())
    for name in FIELDS:
        digest.update(getattr(model, name).detach().contiguous().numpy())
    return digest.hexdigest()


class QuantisedModel(GaussianModel):
    """Merged Gaussians, their view-dependent colour seen as it will be stored."""

    def __init__(
        self,
        start: Gaussians,
        rates: Rates,
        quantise_from: float,
        base: Settings,
        pack: FileSettings | Steps | None = None,
        *,
        extent: float = 0.0,
    ) -> None:
        """Start from a merged model.

        Args:
            start: The merged model, already cleaned.
            rates: Learning rates; those of geometry are 0 where none moves.
            quantise_from: Share of the steps after which harmonics are seen as they will be stored.
            base: Settings that the blocks were trained with; mode and dropout count.
            pack: Gate of the paper's file or steps of ours; None: the paper's without a gate.
            extent: Size of the scene in scene units, which positions move in proportion to.
        """
        super().__init__(start, rates, extent=extent, mode=base.mode, dropout=base.dropout)
        self.quantise_from, self.pack = quantise_from, pack

    def stored_harmonics(
        self, moment: Moment
    ) -> tuple[Float[Tensor, "n r 3"], Bool[Tensor, "n 1 1"]] | None:
        """Residual harmonics, gated and on the lattice of 256 values that they will have, or on our steps.

        What the gate drops is 0 and gets no gradient: it is not stored, and the colour that is the same
        from all sides learns to do without it.

        Args:
            moment: Says whether it is time for that.
        """
        if moment.step <= self.quantise_from * moment.total:
            return None
        rows = self.parameters.rows
        whole = rows["sh_rest"].detach()
        if isinstance(self.pack, Steps):
            scales, logits = (rows[n].detach() for n in ("log_scales", "opacity_logits"))
            shown = torch.ones(len(whole), 1, 1, dtype=torch.bool, device=whole.device)
            logits = logits.clamp(-MOST_LOGIT, MOST_LOGIT)  # as the file stores them
            return stored_harmonics(whole, scales, logits, self.pack), shown
        kept = torch.ones(len(whole), dtype=torch.bool, device=whole.device)
        if self.pack is not None:
            kept = open_gate(whole, self.pack.gate, self.pack.weighting)
        shown = kept[:, None, None]
        rest = torch.where(shown, whole, 0).flatten(start_dim=1)
        low, reach = lattice(rest)
        # reference.compression.affine_codes.fake_quantise, in place and without a graph: half of its time
        rest.sub_(low).mul_(torch.where(reach > 0, STEPS / reach, 0)).round_()
        return rest.mul_(reach / STEPS).add_(low).reshape_as(whole).mul_(shown), shown
