"""Method auto: measure a scene, plan for a budget, train."""

import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise

from splatproof.base.files import read_json, write_text
from splatproof.base.memory import available_mb
from splatproof.base.typed_toml import build
from splatproof.methods.auto.base import (
    Base,
    finished,
    prepare,
    started,
    without_what_is_lacking,
)
from splatproof.methods.auto.bounds import PIXELS_A_GAUSSIAN, bounded
from splatproof.methods.auto.candidates import candidates, compete
from splatproof.methods.auto.choices import Choice
from splatproof.methods.auto.completion import (
    LEAST,
    completing,
    planned_completion,
    shortened,
    sized,
    too_slow,
)
from splatproof.methods.auto.facts import SceneFacts, facts_of, without_points
from splatproof.methods.auto.full_size import enlarge
from splatproof.methods.auto.goal import Goal, keep_back
from splatproof.methods.auto.matching import planned_matching
from splatproof.methods.auto.motion import planned_motion
from splatproof.methods.auto.photos import Photos, planned_photos, reading_threads, working
from splatproof.methods.auto.planner import AutoPlan, plan
from splatproof.methods.auto.points import LEAST_POINTS, lacking_points, with_enough
from splatproof.methods.auto.probe import PIXELS, better, probe_of
from splatproof.methods.auto.recount import Recount
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed, measure
from splatproof.methods.auto.steps import most_steps, steps_in, training_seconds
from splatproof.methods.auto.usual import WIDEST_AT_POINTS, usual
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.exposure import exposed
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.initialise import with_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.remembering import remembering
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.threads import threads
from splatproof.reference.types.scene import Scene, View

PLAN = "plan.json"
"""The plan beside the checkpoint: a run that is continued keeps it."""
RESERVE = 0.03
"""Share of the seconds that is kept back for what nobody can measure before."""
READING, ALL_READ = 0.1, 0.5
"""Share of the seconds in which photos are read ahead; of large ones, which training could not read as it goes, all are."""
PROBE_STEPS = 300
"""Steps of each training of the probe."""
Clock = Callable[[], float]


@dataclass(frozen=True, kw_only=True)
class Planned:
    """A plan and the facts that it was made of."""

    plan: AutoPlan
    facts: SceneFacts
    start: Scene | None = None
    """The scene with the points that training starts from, where they had to be made for the plan."""


def fit(scene: Scene, settings: AutoSettings, run: Run) -> Reconstruction:
    """Measure, plan and train within the seconds that were asked for.

    Args:
        scene: The scene, with sparse points and training views.
        settings: The budget, and what of the plan is fixed.
        run: Where checkpoints and the plan go; a run that is there already is continued by its plan.

    Raises: As methods 3dgs and pvg.

    Source: ours.
    """
    began = time.perf_counter()
    key = run_key(scene, settings, run)
    kept = None if run.folder is None else run.folder / "checkpoint" / PLAN
    told = read_json(kept) if kept is not None and kept.is_file() else {}
    told = told if told.get("key") == key else {}
    if told:
        # a plan from before photos were planned has them all, as they are
        photos = Photos(factor=told.get("factor", 1.0), train=tuple(told.get("train", scene.train)))
    else:
        photos = planned_photos(scene, settings, run)
    scene = remembering(working(scene, photos), run.image_bytes)
    goal = keep_back(scene) if settings.db else None
    scene = goal.scene if goal else scene
    if told:
        chosen, spent = build(Settings, told["settings"], str(kept)), float(told["spent"])
        base: Base = told["base"]
        choices = tuple(Choice(**one) for one in told["choices"])
        start = _started(scene, chosen, run, base)
    else:
        made = planned(scene, settings, run, photos)
        chosen, choices, base = made.plan.settings, made.plan.choices, made.plan.base
        start = made.start or _started(scene, chosen, run, base)
        spent = time.perf_counter() - began
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            stored = {"key": key, "factor": photos.factor, "train": photos.train,
                      "settings": asdict(chosen), "base": base, "spent": spent,
                      "choices": [asdict(one) for one in choices]}  # fmt: skip
            write_text(kept, json.dumps(stored))
    run.on_stage("plan", spent)  # of the first attempt, where this one goes on
    for one in choices:
        run.say(f"{one.component}: {one.value} ({one.because})")
        run.on_fact(f"plan: {one.component}", f"{one.value} ({one.because})")
    run.on_fact("planned settings", json.dumps(asdict(chosen)))

    finish = partial(finished, scene=scene, backend=run.backend, base=base)

    def prepared() -> tuple[Model, Plan]:
        began = time.perf_counter()
        model, plan = prepare(start, chosen, run, base)
        plan = replace(plan, key=key)
        if settings.steps is None:
            preparing = time.perf_counter() - began
            left = settings.seconds * (1 - RESERVE) - spent - preparing
            most, _ = most_steps(chosen, len(plan.views), base)
            plan = replace(plan, recount=Recount(chosen, left, most, told_steps))
        trained = exposed(model, chosen.exposure, plan.views)
        if goal is not None:
            plan = replace(plan, recount=Goal(
                goal, trained, least=settings.db, steps=plan.steps, finish=finish, background=run.background,
                tell=partial(run.on_fact, "quality asked for"), otherwise=plan.recount,
            ))  # fmt: skip
        return trained, plan

    def told_steps(steps: int) -> None:
        run.on_fact("steps for the seconds that were left", str(steps))

    trained = train(run, prepared)
    if photos.factor > 1:
        enlarge(trained, [view.camera for view in scene.train_views], photos.factor)
    return finish(trained)


def read_ahead(scene: Scene, seconds: float, readers: int) -> None:
    """Read training photos side by side, so that whatever looks at them next finds them in memory.

    Args:
        scene: One that remembers its photos.
        seconds: Wall seconds after which no further photo is begun; training reads the others itself.
        readers: How many are read at once.
    """
    ends = time.perf_counter() + seconds

    def read(view: View) -> None:
        if time.perf_counter() < ends:
            view.load()

    with ThreadPoolExecutor(readers) as pool:
        list(pool.map(read, scene.train_views))


def _started(scene: Scene, chosen: Settings, run: Run, base: Base) -> Scene:
    with threads(run.threads):
        return started(scene, chosen, run, base)


def planned(
    scene: Scene, settings: AutoSettings, run: Run, photos: Photos | None = None
) -> Planned:
    """Facts, speed, what the probe says, and the plan that follows; nothing is kept of the trainings.

    Args:
        scene: The scene as a method gets it, with the photos that are trained on.
        settings: The budget, and what of the plan is fixed.
        run: Seed, threads and backend.
        photos: What was decided of the photos; None: they are all there.

    Raises: DataError for a scene that cannot be trained on.
    """
    clock = time.perf_counter
    photos = photos or Photos(train=scene.train)
    began = clock() - photos.seconds
    free = available_mb()
    with threads(run.threads):
        share = ALL_READ if photos.readers else READING
        readers = photos.readers or reading_threads(1.0, scene.train_views, run.image_bytes)
        read_ahead(scene, share * settings.seconds, readers)
        bare, pointed = not len(scene.points), with_enough(scene, run.seed)
        own = facts_of(pointed if bare else scene)
        if bare:
            own = without_points(own)
        moves, motion = planned_motion(scene, settings, own)
        few = not moves and len(scene.points) < LEAST_POINTS
        facts = replace(own, points=len(pointed.points)) if few else own
        chosen = bounded(settings, usual(settings, facts), facts, free, run.image_bytes)
        matching = planned_matching(scene, settings, own, chosen.most_points, run)
        chosen = replace(
            chosen, dense_cell=matching.cell,
            dense=replace(chosen.dense, partners=matching.partners),
        )  # fmt: skip
        completes, completion = planned_completion(
            settings, facts, points=len(scene.points), moves=moves
        )
        base: Base = "pvg" if moves else "3dgs"
        if moves:
            chosen = without_what_is_lacking(chosen)
        start = speed = None
        unkept, matched = replace(run, folder=None), scene
        if completes or few:
            matched = with_points(scene, unkept, dense_cell=chosen.dense_cell, dense=chosen.dense)
        if completes:
            trial = completing(chosen, settings)
            start = started(matched, replace(trial, dense_cell=0.0), unkept, "stratosplat")
            speed = measure(start, trial, run, "stratosplat")
            left = settings.seconds * (1 - RESERVE) - (clock() - began)
            counted = replace(facts, points=len(start.points))
            fits = partial(steps_in, left, facts=counted, speed=speed, least=0)
            smaller: tuple[Choice, ...] = ()
            if settings.steps is None and settings.coarsest is None:
                trial, smaller = sized(trial, facts, fits)
            count = settings.steps or fits(trial)
            if settings.completed or count >= LEAST:
                chosen, base = shortened(trial, count), "stratosplat"
                completion = (*completion, *smaller)
            else:
                start = speed = None
                completion = (too_slow(count),)
        if base == "3dgs" and (completes or (few and not bare)):
            start = started(matched, replace(chosen, dense_cell=0.0), unkept, base)
        speed = speed or measure(scene, chosen, run, base)
        chosen, choices = _probed(scene, settings, facts, chosen, speed, run)
    left = settings.seconds * (1 - RESERVE) - (clock() - began)
    if start is None:
        left -= matching.seconds
    drawn = bare or (few and base == "3dgs" and len(matched.points) < LEAST_POINTS)
    lacking = (lacking_points(len(matched.points)),) if drawn else ()
    choices = (*photos.choices, *lacking, matching.choice, *motion, *completion, *choices)
    points = len(start.points) if start else facts.points
    made = plan(
        settings, replace(facts, points=points), chosen, choices, speed, left, free, base,
        run.image_bytes,
    )  # fmt: skip
    return Planned(plan=made, facts=facts, start=start)


def _probed(
    scene: Scene, asked: AutoSettings, facts: SceneFacts, usual: Settings, speed: Speed, run: Run
) -> tuple[Settings, tuple[Choice, ...]]:
    """The usual settings with what won in short trainings from sparse points, and why."""
    began = time.perf_counter()
    competing = candidates(asked, facts)
    probe = probe_of(scene, run) if asked.probe_share and competing else None
    if probe is None:
        return usual, ()
    most = max(1000, facts.views * PIXELS // PIXELS_A_GAUSSIAN)
    # so short a training looks seldom: without the bound of few looks fog is what a gain makes up for
    tried = replace(
        usual, iterations=PROBE_STEPS, dense_cell=0.0, density=replace(usual.density, most=most),
        widest_at_points=WIDEST_AT_POINTS
        if asked.widest_at_points is None
        else asked.widest_at_points,
    )  # fmt: skip
    factor = max(1.0, math.sqrt(facts.width * facts.height / PIXELS))
    small = replace(tried, resolution=Resolution(coarsest=factor, full_from=1.0))
    left = _left(
        time.perf_counter, began + asked.probe_share * asked.seconds,
        training_seconds(small, facts, speed, PROBE_STEPS),
    )  # fmt: skip
    won, choices = compete(tried, competing, probe.score, better, left)
    return replace(
        won, iterations=usual.iterations, dense_cell=usual.dense_cell, density=usual.density,
        widest_at_points=usual.widest_at_points,
    ), choices  # fmt: skip


def _left(clock: Clock, ends: float, each: float) -> Callable[[int], bool]:
    """Whether there is time for so many more trainings of the probe.

    Args:
        clock: Seconds.
        ends: When it is over.
        each: Seconds that a training is expected to take; later the longest counts.
    """
    times = [clock()]

    def left(trainings: int) -> bool:
        times.append(clock())
        longest = max(each, *(b - a for a, b in pairwise(times)))
        return times[-1] + longest * trainings <= ends

    return left
