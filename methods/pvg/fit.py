"""Training of method pvg."""

from splatproof.methods.contracts.model import Model, Schedule
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.sky import SKY
from splatproof.methods.dynamic.terms import scene_terms
from splatproof.methods.dynamic.times import clock_of
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import exposed
from splatproof.methods.pvg.control import MovingControl
from splatproof.methods.pvg.model import VibrationModel
from splatproof.methods.pvg.settings import Settings
from splatproof.methods.pvg.start import started
from splatproof.methods.training.initialise import extent, with_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import log_linear, settling, shrink
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Photometric
from splatproof.reference.types.scene import Scene

KIND = "pvg"
"""What its models are loaded as."""


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on scene.train_views and return the model.

    Args:
        scene: With times, sparse points and training views; with LiDAR sweeps and sky masks unless the
            settings do without.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Chen et al. 2023, "Periodic Vibration Gaussian", Sec. 3 and its release.
    """

    def prepared() -> tuple[Model, Plan]:
        pointed = with_points(scene, run, random_points=settings.random_points)
        model, plan = prepare(pointed, settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return DecodedModel.of(KIND, train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: Settings, run: Run) -> tuple[VibrationModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the sparse points to start from.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key; the seed draws the returns.

    Raises: DataError if the scene lacks times, points, training views, or what a term reads.
    """
    clock, size = clock_of(scene), extent(scene)
    parameters = started(scene, settings, clock, run.seed)
    driving = scene_terms(
        scene, settings.lidar, settings.sky, steps=settings.iterations, extent=size
    )
    model = VibrationModel(
        parameters, schedules(settings, size, [*parameters.trained]), clock=clock,
        motion=settings.motion, mode=settings.mode,
        sh_every=settings.sh_interval * shrink(settings.iterations), covered=settings.sky.covered,
    )  # fmt: skip
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=(*driving, Photometric(dssim=settings.dssim)),
        density=MovingControl(
            settings.density,
            iterations=settings.iterations,
            extent=size,
            parameters=parameters,
            motion=settings.motion,
        ),
        key=run_key(scene, settings, run),
        views_per_step=settings.views_per_step,
        native=False,
    )


def schedules(settings: Settings, extent: float, trained: list[str]) -> dict[str, Schedule]:
    """Rate of every tensor that is trained; one whose rate is 0 is frozen.

    Args:
        settings: rates and sky.rate count.
        extent: Size of the scene in scene units, which positions and velocities go by.
        trained: Names of the tensors that there are.
    """
    rates = settings.rates
    every = {
        "means": log_linear(rates.means, rates.means_final, factor=extent),
        "peaks": log_linear(rates.peaks, rates.peaks_final),
        "log_spans": settling(rates.log_spans, rates.settle),
        "velocities": settling(rates.velocities * extent, rates.settle),
        SKY: settling(settings.sky.rate, rates.settle),
    } | {
        name: settling(getattr(rates, name), rates.settle)
        for name in ("sh_dc", "sh_rest", "opacity_logits", "log_scales", "quaternions")
    }
    total = settings.iterations
    return {name: rate for name, rate in every.items() if name in trained and rate(1, total) > 0}
