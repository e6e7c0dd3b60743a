"""Method mip-splatting: 3dgs with a 3D smoothing filter on each Gaussian and antialiased rendering."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatproof.methods.contracts.method import Method
from splatproof.methods.contracts.model import TRAINED, Model, Moment
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.models.gaussian_model import GaussianModel, assemble
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import initialise
from splatproof.methods.training.density import RESET_OPACITY
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import require, shrink
from splatproof.methods.training.session import train
from splatproof.reference.rasterizer.smoothing import sampling_widths, smoothed
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

FILTER = "smoothing"
"""Label of rows: standard deviation of a Gaussian's filter in scene units."""

EDGE = 1e-6
"""Drawn opacities stay this far from 0 and 1, where their logits would be infinite."""


@dataclass(frozen=True, kw_only=True)
class MipSettings(Settings):
    """Method mip-splatting. Steps are those of a 30,000 iteration run; a shorter run shrinks them."""

    antialiased: bool = True
    """The 2D Mip filter: scale opacities by what the rasterizer's low-pass spreads a Gaussian over (ours
    has 0.3 squared pixels, the release 0.1). False: without it, an ablation of the paper."""
    smoothing: float = 0.2
    """Variance of the 3D filter, in squared pixels; a pixel at a place is as wide as its smallest depth in
    a training photo by the largest focal length of all of them, as in the release, whichever camera
    has it. 0: without it, an ablation of the paper."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(0 <= self.smoothing < math.inf, "smoothing", self.smoothing, ">= 0")


class MipModel(GaussianModel):
    """Gaussians that are drawn through their smoothing filters, which are labels of the rows."""

    def drawn_rows(self, moment: Moment) -> dict[str, Tensor]:
        """The trained tensors with scales and opacities after the filter.

        Args:
            moment: Not looked at: the filter is always on.
        """
        del moment
        rows = dict(self.parameters.rows)
        scales, opacities = _through(rows, self.parameters.labels[FILTER])
        return rows | {"log_scales": scales.log(), "opacity_logits": opacities.logit(EDGE)}

    def gaussians(self) -> Gaussians:
        """The Gaussians as they are drawn, on the CPU, without gradients."""
        drawn = self.drawn_rows(TRAINED)
        values = {name: value.detach().cpu() for name, value in drawn.items()}
        return assemble(values, self.degree)


class MipControl(DensityControl):
    """Density control by the raw Gaussians, which renews the filters wherever they have moved."""

    cameras: tuple[Camera, ...] = ()
    """Training cameras."""
    variance: float = 0.0
    """Variance of the filter in squared pixels."""

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Densify and reset, where their step has come, and renew the filters every interval.

        Args:
            step: From 1.
            parameters: As for 3dgs, with the label of the filters.
            generator: As for 3dgs.
        """
        yield from super().edits(step, parameters, generator)
        if step % self.settings.interval == 0:
            means = parameters.rows["means"].detach()
            yield Edit(values={FILTER: filters(self.cameras, means, self.variance)})

    def reset(self, parameters: Parameters) -> Edit:
        """Make everything nearly transparent, as it is drawn through the filters.

        Args:
            parameters: As for `edits`.
        """
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        raw = rows["opacity_logits"].sigmoid()
        _, drawn = _through(rows, parameters.labels[FILTER])
        lower = drawn > RESET_OPACITY
        target = (raw * RESET_OPACITY / drawn.where(lower, 1)).logit()
        logits = torch.where(lower, target, rows["opacity_logits"])
        return Edit(values={"opacity_logits": logits}, forget=frozenset({"opacity_logits"}))


def _through(rows: Mapping[str, Tensor], widths: Tensor) -> tuple[Tensor, Tensor]:
    return smoothed(rows["log_scales"].exp(), rows["opacity_logits"].sigmoid(), widths)


def filters(cameras: tuple[Camera, ...], means: Tensor, variance: float) -> Tensor:
    """Standard deviation of each Gaussian's filter in scene units.

    Args:
        cameras: Training cameras.
        means: World positions in scene units.
        variance: In squared pixels.
    """
    return sampling_widths(cameras, means) * math.sqrt(variance)


def fit(scene: Scene, settings: MipSettings, run: Run) -> ExplicitModel:
    """Train on scene.train_views and return the model, its filters worked into the Gaussians.

    Args:
        scene: With sparse points and training views.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Yu et al. 2024, "Mip-Splatting", Sec. 5, with the density control of 3dgs, as for the
        paper's numbers.
    """

    def prepared() -> tuple[Model, Plan]:
        model, plan = prepare(threedgs.started(scene, settings, run), settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return explicit(train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: MipSettings, run: Run) -> tuple[MipModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the points to start from.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key.

    Raises: DataError if there is no point or no training view.
    """
    _, plan = threedgs.prepare(scene, settings, run)
    start = initialise.from_points(
        scene, degree=settings.sh_degree, opacity=settings.initial_opacity
    )
    size = initialise.extent(scene)
    cameras = tuple(view.camera for view in scene.train_views)
    model = MipModel(
        start, settings.rates, extent=size, mode=settings.mode,
        sh_every=settings.sh_interval * shrink(settings.round_steps), dropout=settings.dropout,
        labels={FILTER: filters(cameras, start.means, settings.smoothing)},
    )  # fmt: skip
    density = MipControl(settings.density, iterations=settings.round_steps, extent=size)
    density.cameras, density.variance = cameras, settings.smoothing
    return model, replace(plan, density=density)


MIP_SPLATTING = Method(
    name="mip-splatting",
    settings=MipSettings,
    fit=fit,
    cost=cost,
    description="3dgs with a 3D smoothing filter by the training cameras' resolution and antialiased "
    "rendering (Yu et al. 2024)",
)
