"""Training of method 3dgs, and the parts of it that blocks and refinements share."""

from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.control import control
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import initialise
from splatproof.methods.training.density import Density
from splatproof.methods.training.fewer_points import with_at_most
from splatproof.methods.training.image_room import image_room
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.remembering import remembering
from splatproof.methods.training.schedules import restarts, shrink
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import (
    ImageTerm,
    ParameterTerm,
    Photometric,
    mean_opacity,
    mean_scale,
)
from splatproof.reference.types.scene import Scene


def fit(scene: Scene, settings: Settings, run: Run) -> ExplicitModel:
    """Train on scene.train_views and return the model.

    The optimizer moves in every step, also in those that densify (in the release it does not).

    Args:
        scene: The scene, with sparse points and training views.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5 and Alg. 1.
    """

    def prepared() -> tuple[Model, Plan]:
        model, plan = prepare(started(scene, settings, run), settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return explicit(train(run, prepared), scene, run.backend)


def started(scene: Scene, settings: Settings, run: Run) -> Scene:
    """The scene with the points that training starts from, as the settings say.

    Args:
        scene: The scene, with its own points if it has any.
        settings: Settings of which random_points, dense_cell, dense and most_points count.
        run: Seed of the draw and bound on images in memory.
    """
    pointed = initialise.with_points(
        scene, run, random_points=settings.random_points, dense_cell=settings.dense_cell,
        dense=settings.dense,
    )  # fmt: skip
    most = settings.most_points
    return pointed if most is None else with_at_most(pointed, most)


def prepare(scene: Scene, settings: Settings, run: Run) -> tuple[GaussianModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: The scene, with the points to start from.
        settings: What is chosen about the method.
        run: The run; seed, background, backend and device are part of the plan's key.

    Raises: DataError if there is no point or no training view.
    """
    start = initialise.from_points(
        scene, degree=settings.sh_degree, opacity=settings.initial_opacity
    )
    size = initialise.extent(scene)
    model = GaussianModel(
        start, settings.rates, extent=size, mode=settings.mode,
        sh_every=settings.sh_interval * shrink(settings.round_steps), dropout=settings.dropout,
    )  # fmt: skip
    if isinstance(settings.density, StrategicDensity) and settings.density.looks:
        scene = remembering(scene, image_room(run.image_bytes, scene.train_views).kept)
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=(*terms(settings), *moving_terms(settings.density, size)),
        density=control(settings, scene.train_views, size, run),
        key=run_key(scene, settings, run),
        restarts=restarts(settings.iterations, settings.rounds),
        views_per_step=settings.views_per_step,
        resolution=settings.resolution,
        random_background=settings.random_background,
        shapes=settings.shapes,
    )


def terms(settings: Settings) -> tuple[ImageTerm | ParameterTerm, ...]:
    """What method 3dgs minimises, whatever controls its density.

    Args:
        settings: Settings of which dssim and opacity_weight count.
    """
    image = Photometric(dssim=settings.dssim)
    return (image, mean_opacity(settings.opacity_weight)) if settings.opacity_weight else (image,)


def moving_terms(density: Density, extent: float) -> tuple[ParameterTerm, ...]:
    """What strategy mcmc minimises besides; nothing for others.

    Args:
        density: What is chosen about density control.
        extent: Size of the scene in scene units.
    """
    if not isinstance(density, StrategicDensity) or density.strategy != "mcmc":
        return ()
    weight = density.mcmc.scale_weight
    return (mean_scale(weight, extent),) if weight else ()
