"""Method auto: measure a scene, plan for a budget, train."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise

from splatproof.base.files import read_json, write_text
from splatproof.base.typed_toml import build
from splatproof.datasets.image_cache import ImageCache
from splatproof.methods.auto.facts import SceneFacts, facts_of
from splatproof.methods.auto.planner import AutoPlan, Choice, candidates, compete, plan, usual
from splatproof.methods.auto.probe import better, probe_of
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import measure
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.session import run_key
from splatproof.methods.training.threads import threads
from splatproof.reference.types.scene import Scene

PLAN = "plan.json"
"""The plan beside the checkpoint: a run that is continued keeps it."""
RESERVE = 0.03
"""Share of the seconds that is kept back for what nobody can measure before."""
PROBE_STEPS = 300
"""Steps of each training of the probe."""
Clock = Callable[[], float]


@dataclass(frozen=True, kw_only=True)
class Planned:
    """A plan and the facts that it was made of."""

    plan: AutoPlan
    facts: SceneFacts


def fit(scene: Scene, settings: AutoSettings, run: Run) -> ExplicitModel:
    """Measure, plan and train within the seconds that were asked for.

    Args:
        scene: The scene, with sparse points and training views.
        settings: The budget, and what of the plan is fixed.
        run: Where checkpoints and the plan go; a run that is there already is continued by its plan.

    Raises: As method 3dgs.

    Source: ours.
    """
    key = run_key(scene, settings, run)
    scene = remembering(scene, run.image_bytes)
    kept = None if run.folder is None else run.folder / "checkpoint" / PLAN
    if kept is not None and kept.is_file() and (told := read_json(kept)).get("key") == key:
        chosen = build(Settings, told["settings"], str(kept))
        choices = tuple(Choice(**one) for one in told["choices"])
    else:
        started = time.perf_counter()
        made = planned(scene, settings, run)
        chosen, choices = made.plan.settings, made.plan.choices
        run.on_stage("plan", time.perf_counter() - started)
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            stored = {"key": key, "settings": asdict(chosen),
                      "choices": [asdict(one) for one in choices]}  # fmt: skip
            write_text(kept, json.dumps(stored))
    for one in choices:
        run.say(f"{one.component}: {one.value} ({one.because})")
        run.on_fact(f"plan: {one.component}", f"{one.value} ({one.because})")
    run.on_fact("planned settings", json.dumps(asdict(chosen)))
    return threedgs.fit(scene, chosen, run)


def remembering(scene: Scene, image_bytes: int) -> Scene:
    """The scene whose photos are read once for all that looks at them, as far as memory is allowed.

    Args:
        scene: The scene as a method gets it.
        image_bytes: Most bytes of photos that are kept.
    """
    cache = ImageCache(image_bytes)
    train = set(scene.train)
    views = tuple(
        replace(view, load=partial(cache.load, view)) if index in train else view
        for index, view in enumerate(scene.views)
    )
    return replace(scene, views=views)


def planned(scene: Scene, settings: AutoSettings, run: Run) -> Planned:
    """Facts, speed, what the probe says, and the plan that follows; nothing is kept of the trainings.

    Args:
        scene: The scene as a method gets it.
        settings: The budget, and what of the plan is fixed.
        run: Seed, threads and backend.

    Raises: DataError for a scene that cannot be trained on.
    """
    clock = time.perf_counter
    started = clock()
    with threads(run.threads):
        facts = facts_of(scene, run.image_bytes)
        chosen = usual(settings, facts)
        speed = measure(scene, chosen, run)
        choices: tuple[Choice, ...] = ()
        probe = probe_of(scene, run) if settings.probe_share else None
        if probe is not None:
            ends = clock() + settings.probe_share * settings.seconds
            tried = replace(chosen, iterations=PROBE_STEPS)
            won, choices = compete(
                tried, candidates(settings, facts), probe.score, better, _left(clock, ends)
            )
            chosen = replace(won, iterations=chosen.iterations)
    left = settings.seconds * (1 - RESERVE) - (clock() - started)
    return Planned(plan=plan(settings, facts, chosen, choices, speed, left), facts=facts)


def _left(clock: Clock, ends: float) -> Callable[[], bool]:
    """Whether one more training of the probe, as long as the longest so far, ends in time."""
    times = [clock()]

    def left() -> bool:
        times.append(clock())
        longest = max(b - a for a, b in pairwise(times))
        return times[-1] + longest <= ends

    return left
