"""Method cor-gs: two fields trained side by side, pruned and regularised where they disagree."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import torch

from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit
from splatproof.methods.sparse_views.density import SparseControl, SparseDensity
from splatproof.methods.sparse_views.nearest import matched
from splatproof.methods.sparse_views.twin_fields import (
    FIELD,
    Paired,
    TwinFields,
    agreement_term,
    in_both,
    twice,
)  # fmt: skip
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import cost as plain_cost
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import initialise
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import require, restarts, shrink
from splatproof.methods.training.session import run_key, train
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene
from splatproof.reference.types.splats import Splats

DEAREST = 5
"""Renders of a step, forwards and backwards, against one of 3dgs: two fields, photo and pseudo view,
and the other field's pseudo view forwards."""


@dataclass(frozen=True, kw_only=True)
class CorGS(Settings):
    """Method cor-gs: two fields of Gaussians that check each other. Steps are those of a 30,000 step
    run; the release's 10,000 are stretched to it. The first field is the result."""

    sh_interval: int = 1500
    """Steps after which each further SH degree is trained; 0: all from the start."""
    random_background: bool = True
    """Whether every view of a step is trained over a colour drawn at random, as the release does."""
    prune_interval: int = 1500
    """Steps between co-prunings, the first one after twice as many, as in the release. 0: none, an ablation of
    the paper."""
    prune_distance: float = 0.1
    """Distance, as a share of the scene's extent, within which the other field must have a Gaussian.
    The release has 5, 10 or 20 scene units by data set; this is ours."""
    agreement_weight: float = 1.0
    """Weight of what the two fields' renders between the training cameras differ by. 0: not
    compared, an ablation of the paper."""
    agreement_start: int = 1500
    """First step that compares them."""
    density: SparseDensity = field(default_factory=SparseDensity)
    """When and where Gaussians are added and removed."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        for name in ("prune_interval", "agreement_start"):
            require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")
        for name in ("prune_distance", "agreement_weight"):
            require(0 <= getattr(self, name) < math.inf, name, getattr(self, name), ">= 0")
        require(
            self.exposure == "off", "exposure", self.exposure, "off: two fields would learn two"
        )


class CoControl(SparseControl):
    """SparseControl that also removes what the other field has nothing near."""

    def __init__(self, settings: CorGS, *, extent: float) -> None:
        """Start without statistics.

        Args:
            settings: All of the method; its steps are shrunk to this run's.
            extent: Size of the scene in scene units.
        """
        steps = settings.round_steps
        super().__init__(settings.density, iterations=steps, extent=extent)
        self.prune_interval = max(
            round(settings.prune_interval * shrink(steps)), min(1, settings.prune_interval)
        )
        self.prune_distance = settings.prune_distance * extent

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Densify and reset as ever, then co-prune, each where its step has come.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors with the label of the fields.
            generator: Source of the children's positions.
        """
        yield from super().edits(step, parameters, generator)
        every = self.prune_interval
        if every and step > every and step % every == 0 and step < self.settings.stop:
            yield self.co_prune(parameters)

    def co_prune(self, parameters: Parameters) -> Edit:
        """Remove the Gaussians of either field that the other has none near, by the same two fields.

        A field of which nothing would be left is left alone (ours).

        Args:
            parameters: The model's tensors with the label of the fields.
        """
        means, label = parameters.rows["means"].detach(), parameters.labels[FIELD]
        keep = torch.ones_like(label, dtype=torch.bool)
        for own in (0, 1):
            mine = label == own
            near = matched(means[mine], means[~mine], self.prune_distance)
            if near.any():
                keep[mine] = near
        return Edit(parents=torch.where(keep)[0])


def fit(scene: Scene, settings: CorGS, run: Run) -> ExplicitModel:
    """Train two fields on scene.train_views and return the first.

    Args:
        scene: With sparse points and training views.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Zhang et al. 2024, "CoR-GS: Sparse-View 3D Gaussian Splatting via Co-Regularization".
    """

    def prepared() -> tuple[TwinFields, Plan]:
        return prepare(threedgs.started(scene, settings, run), settings, run)

    return explicit(train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: CorGS, run: Run) -> tuple[TwinFields, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the points to start from.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key.

    Raises: DataError if there is no point or no training view.
    """
    start, fields = twice(
        initialise.from_points(scene, degree=settings.sh_degree, opacity=settings.initial_opacity)
    )
    size, factor = initialise.extent(scene), shrink(settings.iterations)
    model = TwinFields(
        start, settings.rates, extent=size, mode=settings.mode,
        sh_every=settings.sh_interval * shrink(settings.round_steps), dropout=settings.dropout, labels={FIELD: fields},
    )  # fmt: skip
    terms = threedgs.terms(settings)
    if settings.agreement_weight:
        cameras = tuple(view.camera for view in scene.train_views)
        first = max(1, round(settings.agreement_start * factor))
        steps = range(first, settings.iterations + 1)
        drawn = partial(_draw, run, settings)
        terms = (*terms, agreement_term(
            cameras, drawn, weight=settings.agreement_weight, steps=steps, dssim=settings.dssim
        ))  # fmt: skip
    return model, Plan(
        steps=settings.iterations,
        views=in_both(scene.train_views),
        terms=terms,
        density=CoControl(settings, extent=size),
        key=run_key(scene, settings, run),
        restarts=restarts(settings.iterations, settings.rounds),
        views_per_step=2 * settings.views_per_step,
        random_background=settings.random_background,
        shapes=settings.shapes,
        order=Paired(len(scene.train_views)),
    )


def _draw(run: Run, settings: CorGS, camera: Camera, splats: Splats) -> RenderOutput:
    background = torch.tensor(run.background).to(splats.means)
    return get_backend(run.backend).draw(camera, splats, background=background, mode=settings.mode)


def cost(settings: CorGS, scene: Scene) -> Cost:
    """What method cor-gs takes on a scene: two fields, and renders between the photos.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    one = plain_cost(settings, scene)
    return replace(one, cpu_seconds=DEAREST * one.cpu_seconds, memory_mb=1.5 * one.memory_mb)


COR_GS = Method(
    name="cor-gs",
    settings=CorGS,
    fit=fit,
    cost=cost,
    description="two fields of 3dgs for few views, each pruned where the other has nothing and drawn to its "
    "renders between the photos (Zhang et al. 2024)",
)
