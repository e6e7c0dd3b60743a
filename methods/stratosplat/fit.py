"""Training of method stratosplat."""

from dataclasses import replace

import torch

from splatproof.base.errors import UsageError
from splatproof.datasets.pose_noise import disturbed
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.stratosplat.completion import completed
from splatproof.methods.stratosplat.kept_points import kept_points
from splatproof.methods.stratosplat.model import HybridModel
from splatproof.methods.stratosplat.own_prior import completion_words
from splatproof.methods.stratosplat.own_prior import weights_sha256 as completion_weights
from splatproof.methods.stratosplat.settings import StratoSplat
from splatproof.methods.stratosplat.virtual import drawn_field, stack_of
from splatproof.methods.threedgs.fit import prepare as prepare_explicit
from splatproof.methods.training import initialise
from splatproof.methods.training.fewer_points import with_at_most
from splatproof.methods.training.matchers import weights_sha256
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import shrink
from splatproof.methods.training.session import run_key, train
from splatproof.reference.types.result import TRUE_POSES
from splatproof.reference.types.scene import Scene, SparsePoints

KIND = "stratosplat"
"""What its models with virtual Gaussians are loaded as; without, they are explicit ones."""


def fit(scene: Scene, settings: StratoSplat, run: Run) -> DecodedModel | ExplicitModel:
    """Complete depths, train on scene.train_views and return the model.

    Args:
        scene: With sparse points and training views, which may have depth priors.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued, and so are completed depths.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run, and where noise or a depth prior is asked for twice; SplatproofError if the loss stops being finite.

    Source: StratoSplat, Sec. 3.
    """
    if settings.noise != TRUE_POSES and "pose_noise" in scene.facts:
        raise UsageError(
            f"setting noise is {settings.noise!r}, but the scene's poses have noise "
            f"{scene.facts['pose_noise']!r} already; give one of them"
        )
    words = completion_words(settings, scene)
    if words and "depth_prior" in scene.facts:
        raise UsageError(
            f"setting completion.prior is 'own', but the scene's photos have depth prior "
            f"{scene.facts['depth_prior']!r} already; give one of them"
        )
    if words:
        run.on_fact("completion network", words)

    def prepared() -> tuple[Model, Plan]:
        model, plan = prepare(scene, settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    trained = train(run, prepared)
    if settings.planes.field == "none":
        return explicit(trained, scene, run.backend)
    return DecodedModel.of(KIND, trained, scene, run.backend)


def prepare(scene: Scene, settings: StratoSplat, run: Run) -> tuple[Model, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With sparse points.
        settings: What is chosen about the method.
        run: The run; its seed draws the field and the denoiser's noise.
    """
    shown = disturbed(scene, settings.noise_of("train"), run.seed)
    start = replace(shown, points=started(scene, settings, run))
    model, plan = prepare_from(start, settings, run)
    return model, replace(plan, key=run_key(scene, settings, run, *_priors(scene, settings)))


def prepare_from(start: Scene, settings: StratoSplat, run: Run) -> tuple[Model, Plan]:
    """As `prepare`, from the points that the scene has.

    Args:
        start: With the points that explicit Gaussians start from, which planes and field cover too.
        settings: What is chosen about the method; nothing of its start and its noise counts.
        run: The run; its seed draws the field.

    Raises: DataError for a scene that cannot be trained on.
    """
    explicits, plan = prepare_explicit(start, settings, run)
    if settings.planes.field == "none":
        return explicits, plan
    planes = settings.planes
    return HybridModel(
        explicits.gaussians(), settings.rates, extent=initialise.extent(start),
        stack=stack_of(start.points.positions.double(), start.up, planes.count), planes=planes,
        field=drawn_field(planes, torch.Generator().manual_seed(run.seed)), mode=settings.mode,
        sh_every=settings.sh_interval * shrink(settings.round_steps), dropout=settings.dropout,
    ), replace(plan, native=False)  # fmt: skip


def started(scene: Scene, settings: StratoSplat, run: Run) -> SparsePoints:
    """The points that explicit Gaussians start from: P_dense, or the sparse ones; at most `most_points`.

    Args:
        scene: The scene as it was given, without the noise of a stage.
        settings: init, completion, noise and most_points matter.
        run: Seed, and the folder of the checkpoint.

    Raises: DataError if there is nothing to start from.
    """
    points, most = _all_points(scene, settings, run), settings.most_points
    return points if most is None else with_at_most(replace(scene, points=points), most).points


def _all_points(scene: Scene, settings: StratoSplat, run: Run) -> SparsePoints:
    """However many there are. A completion that ended is kept beside the checkpoint with all that was told of it, so
    that a killed run does not repeat it and a record says the same of it."""
    seen = disturbed(scene, settings.noise_of("completion"), run.seed)
    cell = 0.0 if settings.init == "sfm" else settings.dense_cell
    drawn = 0 if settings.completes else settings.random_points  # what is drawn guides nothing

    def pointed(run: Run) -> Scene:
        return initialise.with_points(
            seen, run, random_points=drawn, dense_cell=cell, dense=settings.dense
        )

    if not settings.completes:
        return pointed(run).points
    key = run_key(scene, settings, run, *_priors(scene, settings))
    path = None if run.folder is None else run.folder / "checkpoint" / "completion.safetensors"
    return kept_points(path, key, run, lambda heard: _completed(pointed(heard), settings, heard))


def _completed(scene: Scene, settings: StratoSplat, run: Run) -> SparsePoints:
    cloud = completed(
        scene, settings.completion, guided=settings.init == "layered",
        generator=torch.Generator().manual_seed(run.seed), report=run.say,
    )  # fmt: skip
    count = len(cloud.positions)
    run.on_fact("points after completion", str(count))
    return SparsePoints(
        positions=cloud.positions, colours=(cloud.colours * 255).round().clamp(0, 255).byte(),
        track_starts=torch.zeros(count + 1, dtype=torch.int64),
        track_views=torch.zeros(0, dtype=torch.int64),
    )  # fmt: skip


def _priors(scene: Scene, settings: StratoSplat) -> tuple[str, ...]:
    """Name and hash of the depth priors that completion reads, or that photos are matched by, and the hashes of the
    weights of a matcher and of the network that completes."""
    matched = settings.init == "dense" and settings.dense.matcher == "prior"
    names = ("depth_prior", "depth_prior_sha256") if settings.completes or matched else ()
    read = tuple(scene.facts[name] for name in names if name in scene.facts)
    matches = settings.init != "sfm" and settings.dense_cell
    matcher = weights_sha256(settings.dense) if matches else ""
    return (*read, *(weights for weights in (matcher, completion_weights(settings)) if weights))
