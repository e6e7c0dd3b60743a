"""Training of method dlg-gs."""

from collections.abc import Iterable

import torch
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.methods.anchors import networks
from splatproof.methods.anchors.control import AnchorControl
from splatproof.methods.anchors.model import AnchorModel
from splatproof.methods.anchors.start import started, voxel_size
from splatproof.methods.contracts.model import Model, Schedule
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs.light import STATISTICS, drawn_light
from splatproof.methods.dlg_gs.model import GATES, HEAD, INPUTS, MIXING, DlgModel, Lighting
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.dlg_gs.terms import terms
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import exposed
from splatproof.methods.scaffold import fit as scaffold
from splatproof.methods.training.initialise import extent, require_points, with_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import log_linear
from splatproof.methods.training.session import run_key, train
from splatproof.reference.anchors import attention
from splatproof.reference.types import mlp
from splatproof.reference.types.scene import Scene

KIND = "dlg-gs"
"""What its models are loaded as."""
MARGIN = 0.05
"""Share of the points' largest extent by which the scene's box is larger on each side."""
START = 2.0
"""Bias of the share that original colours have in adapted ones: 0.88 of them at the start."""
OTHER_DRAWS = 2**32
"""Added to the seed for what scaffold-gs does not draw, so that it draws the same without."""


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on scene.train_views and return the model.

    Args:
        scene: With sparse points and training views; with depth priors unless `vdjc` is off.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if depth priors are missing or
        the checkpoint belongs to another run; SplatproofError if the loss stops being finite.

    Source: Li et al. 2026, "DLG-GS", Sec. 2.
    """
    require_priors(scene, settings)

    def prepared() -> tuple[Model, Plan]:
        start = with_points(scene, run, random_points=settings.random_points)
        model, plan = prepare(start, settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return DecodedModel.of(KIND, train(run, prepared), scene, run.backend)


def require_priors(scene: Scene, settings: Settings) -> None:
    """Refuse a scene that the depth terms cannot be computed on.

    Args:
        scene: Every one of its training views needs a depth prior, if `vdjc` is on.
        settings: vdjc counts.

    Raises: UsageError that names a view without.
    """
    if settings.vdjc == "off":
        return
    for view in scene.train_views:
        if view.load_prior is None:
            raise UsageError(
                f"scene {scene.name}: training view {view.name} has no depth prior, and setting vdjc "
                f"is {settings.vdjc!r}; give priors with --depth-prior, or do without: --vdjc off"
            )


def prepare(scene: Scene, settings: Settings, run: Run) -> tuple[AnchorModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the points to start from; the training images are read once.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key; the seed draws the networks.

    Raises: DataError if there is no point or no training view.
    """
    require_points(scene)
    density = settings.density
    voxel = settings.voxel or voxel_size(scene, settings.voxel_rule, density.coarsest)
    size = extent(scene)
    decoding = networks.named(scaffold.drawn_networks(settings, run.seed))
    lit = drawn_lighting(scene, settings, run.seed)
    parameters = started(
        scene, voxel=voxel, k=settings.k, features=settings.features,
        shared=decoding | lit, moving=settings.moves,
    )  # fmt: skip
    rates = schedules(settings, decoding, lit, size)
    if settings.dlaam == "off":
        model = AnchorModel(parameters, rates, with_distance=settings.distance)
    else:
        radius = settings.radius * density.coarsest * voxel
        model = DlgModel(
            parameters, rates, with_distance=settings.distance,
            lighting=placed(scene, radius=radius, extent=size),
        )  # fmt: skip
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=terms(settings, run),
        density=AnchorControl(
            density, iterations=settings.iterations, voxel=voxel, extent=size, k=settings.k
        ),
        key=run_key(scene, settings, run),
        views_per_step=settings.views_per_step,
    )


def placed(scene: Scene, *, radius: float, extent: float) -> Lighting:
    """Where and among whom colours adapt.

    Args:
        scene: Its points span the box; its training views have factors.
        radius: How far an anchor sees others, scene units.
        extent: Size of the scene in scene units.
    """
    positions = scene.points.positions.double()
    low, high = positions.amin(dim=0), positions.amax(dim=0)
    # Points on a plane, or a single one, span no box of their own.
    margin = MARGIN * max(float((high - low).max()), extent)
    return Lighting(
        views=tuple(view.name for view in scene.train_views),
        low=tuple((low - margin).tolist()),
        high=tuple((high + margin).tolist()),
        radius=radius,
        extent=extent,
    )


def drawn_lighting(scene: Scene, settings: Settings, seed: int) -> dict[str, Tensor]:
    """The tensors of the lighting at their start, by name; none where it is off.

    Args:
        scene: Its training images are read, unless factors are learnt.
        settings: dlaam, factor and widths count.
        seed: Seed of the draw.
    """
    if settings.dlaam == "off":
        return {}
    generator = torch.Generator().manual_seed(seed + OTHER_DRAWS)
    light = drawn_light(scene.train_views, settings.factor, settings.factor_width, generator)
    weights = attention.create(INPUTS, INPUTS, generator)
    names = (*GATES, *MIXING) if settings.dlaam == "full" else GATES
    sizes = (3 + settings.factor_width + INPUTS, settings.head, settings.head, 4)
    head = mlp.create(sizes, generator)
    head.biases[-1][3] = START
    return (
        light
        | networks.named({HEAD: head})
        | {f"attention.{name}": getattr(weights, name) for name in names}
    )


def schedules(
    settings: Settings, decoding: Iterable[str], lighting: Iterable[str], extent: float
) -> dict[str, Schedule]:
    """Rate of every trained tensor; the statistics of photos have none.

    Args:
        settings: rates count, and whether anchors move.
        decoding: Names of the tensors of the decoding networks.
        lighting: Names of those that `drawn_lighting` made.
        extent: Size of the scene in scene units.
    """
    rates = settings.rates
    light = log_linear(rates.light, rates.light_final)
    made = scaffold.schedules(rates, [*decoding]) | {
        name: light for name in lighting if name != STATISTICS
    }
    if settings.moves:
        made["centres"] = log_linear(rates.centres, rates.centres_final, factor=extent)
    return made
