"""Training of method hdgs."""

import math
from dataclasses import replace

import torch

from splatproof.methods.contracts.model import Model, Schedule
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic import sky
from splatproof.methods.dynamic.sweep_motion import in_motion
from splatproof.methods.dynamic.sweep_points import TimedPoints, joined, timed_points
from splatproof.methods.dynamic.terms import scene_terms
from splatproof.methods.dynamic.times import Clock, clock_of
from splatproof.methods.hdgs import networks
from splatproof.methods.hdgs.control import HdgsControl
from splatproof.methods.hdgs.depth import depth_terms
from splatproof.methods.hdgs.model import CYCLE, Frame, HdgsModel
from splatproof.methods.hdgs.settings import Settings
from splatproof.methods.hdgs.start import sites, started, voxel_for
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import exposed
from splatproof.methods.training.initialise import extent, require_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import log_linear
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import ImageTerm, Photometric
from splatproof.reference.types.scene import Scene

KIND = "hdgs"
"""What its models are loaded as."""
ALWAYS = 1e4
"""Life span of anchors that are always there, in durations of the drive."""
WITHIN = 0.9
"""Share of the points that lie within one unit of the model's origin."""
FAR = 10.0
"""Distance in the model's unit from which points are left to the sky, where there is one: networks read
positions."""


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on scene.train_views and return the model.

    Args:
        scene: A drive: views have times; points or LiDAR sweeps to start from.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that lacks what the settings ask for; UsageError if the checkpoint
        belongs to another run; SplatproofError if the loss stops being finite.

    Source: Ge et al., "HDGS: Hierarchical Dynamic Gaussian Splatting for Urban Driving Scenes".
    """

    def prepared() -> tuple[Model, Plan]:
        model, plan = prepare(scene, settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return DecodedModel.of(KIND, train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: Settings, run: Run) -> tuple[HdgsModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: As for `fit`.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key; the seed draws the networks.

    Raises: DataError for a scene that lacks what the settings ask for.
    """
    clock, size = clock_of(scene), extent(scene)
    points = measured(scene, run.seed, sweeps=settings.from_sweeps)
    frame, moves = frame_of(points.positions), settings.motion == "vibration"
    points = in_model(points, frame, clock, moves=moves, sky=settings.sky.resolution > 0)
    voxel = settings.voxel / frame.unit
    voxel = voxel or voxel_for(points.positions, settings.anchors)
    at = sites(points, voxel, middle=0.0)
    sizes, duration = settings.sizes, clock.duration / CYCLE
    spans = torch.full((len(at.times),), duration * (settings.still_span if moves else ALWAYS))
    parameters = started(
        at, sizes, spans=torch.where(at.moves, settings.moving_span, spans),
        lone=0.01 * size / frame.unit,
        shared=networks.drawn(sizes, run.seed, ice=settings.ice != "off")
        | sky.started(settings.sky),
        generator=torch.Generator().manual_seed(run.seed),
    )  # fmt: skip
    model = HdgsModel(
        parameters, schedules(settings, [*parameters.trained]), sizes=sizes, frame=frame,
        clock=clock, voxel=voxel / 2, ice=settings.ice, smoothing=settings.smoothing,
        covered=settings.sky.covered,
    )  # fmt: skip
    image: tuple[ImageTerm, ...] = (Photometric(dssim=settings.dssim),)
    of_scene = scene_terms(
        scene, settings.lidar, settings.sky, steps=settings.iterations, extent=frame.unit
    )
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=image + of_scene + depth_terms(scene, settings.depth, frame.unit),
        density=HdgsControl(
            settings.density, model.parameters, sizes, iterations=settings.iterations,
            views=len(scene.train_views), voxel=voxel / 2, moments=moments(scene, clock),
        ),
        key=run_key(scene, settings, run),
        views_per_step=settings.views_per_step,
    )  # fmt: skip


def measured(scene: Scene, seed: int, *, sweeps: bool) -> TimedPoints:
    """Sparse points, which stand still, and returns of LiDAR sweeps where there are some, shuffled.

    Args:
        scene: Training views and points count.
        seed: Seed of the order.
        sweeps: Whether sweeps are read.

    Raises: DataError if there is no point of either kind, or no training view.
    """
    swept = sweeps and any(view.load_sweep for view in scene.train_views)
    if not scene.train or not swept:
        require_points(scene)
    count = len(scene.points)
    sparse = TimedPoints(
        positions=scene.points.positions.double(), colours=scene.points.colours,
        seconds=torch.zeros(count).double(), moved=torch.zeros(count).bool(),
        velocities=torch.zeros(count, 3),
    )  # fmt: skip
    returns = [in_motion(timed_points(scene), scene.up)] if swept else []
    points = joined([sparse, *returns])
    generator = torch.Generator().manual_seed(seed)
    return points.take(torch.randperm(len(points), generator=generator))


def in_model(
    points: TimedPoints, frame: Frame, clock: Clock, *, moves: bool, sky: bool
) -> TimedPoints:
    """The points as the model counts lengths and times, without those left to the sky, if it has one.

    Args:
        points: In scene units and seconds.
        frame: The model's coordinates.
        clock: What turns seconds into model time.
        moves: Whether anything may move.
        sky: Whether the model has a sky.
    """
    second = clock.second / CYCLE
    places = frame.inwards(points.positions)
    kept = places.norm(dim=1) < (FAR if sky else math.inf)
    return replace(
        points,
        positions=places,
        seconds=(points.seconds - clock.middle) * second,
        moved=points.moved & moves,
        velocities=points.velocities / (frame.unit * second),
    ).take(kept)


def frame_of(positions: torch.Tensor) -> Frame:
    """Coordinates in which most of what was measured lies within 1 of the origin.

    Args:
        positions: Points in the scene's frame.
    """
    middle = positions.median(dim=0).values
    x, y, z = middle.tolist()
    away = (positions - middle).norm(dim=1).sort().values
    return Frame(middle=(x, y, z), unit=float(away[round(WITHIN * (len(away) - 1))]) or 1.0)


def moments(scene: Scene, clock: Clock) -> tuple[float, float]:
    """First and last time of the training views, in the unit of the peaks.

    Args:
        scene: Whose views have times.
        clock: What turns them into model time.
    """
    times = [clock.of(view) / CYCLE for view in scene.train_views]
    return min(times), max(times)


def schedules(settings: Settings, trained: list[str]) -> dict[str, Schedule]:
    """Rate of every trained tensor; without motion, peaks, velocities and spans have none.

    Args:
        settings: rates, motion and the sky's rate count.
        trained: Names of all rows and shared tensors.
    """
    made = {name: schedule_of(name, settings) for name in trained}
    if settings.motion == "static":
        for name in ("peaks", "velocities", "log_spans"):
            del made[name]
    return made


def schedule_of(name: str, settings: Settings) -> Schedule:
    """Rate of one tensor.

    Args:
        name: Name of a row or shared tensor.
        settings: As for `schedules`.
    """
    if name == sky.SKY:
        return log_linear(settings.sky.rate, settings.sky.rate)
    kind = name.partition(".")[0].rstrip("12345")
    if "position" in kind:
        kind = "position"
    elif kind.startswith("layer"):
        kind = "residual"
    elif kind.startswith("ice"):
        kind = "ice"
    first = getattr(settings.rates, kind)
    return log_linear(first, getattr(settings.rates, f"{kind}_final", first))
