"""A method that trains nothing but checkpoints, can be killed, and fails on request."""

import errno
import json
import os
import time
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import write_text
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import METHODS
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene
from splatproof.suites import run_case as cases
from splatproof.suites.run_case import Job, Tell, run_case


@dataclass(frozen=True, kw_only=True)
class Inner:
    """Nested settings."""

    rate: float = 0.5
    cap: int | None = None


@dataclass(frozen=True, kw_only=True)
class FakeSettings:
    """Settings of the fake method."""

    iterations: int = 40
    seconds_a_step: float = 0.0
    checkpoint_steps: int = 5
    fail_with: str = ""
    """Message of the error that fit raises at the middle step; empty: none."""
    crash: bool = False
    """End the process without a word at the middle step."""
    elsewhere: float = 0.0
    """CPU seconds, and megabytes of memory, that it says were spent in other processes; 0: it says nothing."""
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        """Refuse a run of no steps."""
        if self.iterations < 1:
            raise UsageError(f"iterations is {self.iterations}, expected 1 or more")


def fit(scene: Scene, settings: FakeSettings, run: Run) -> ExplicitModel:
    """A random walk of one number, continued from its checkpoint bit by bit."""
    assert run.folder is not None
    path = run.folder / "checkpoint" / "state.json"
    rng = np.random.default_rng(run.seed)
    step, value, seconds = 0, 0.0, 0.0
    if path.exists():
        state = json.loads(path.read_text())
        step, value, seconds = state["step"], state["value"], state["seconds"]
        rng.bit_generator.state = state["rng"]
    run.on_stage("init", 0.001)
    while step < settings.iterations:
        step += 1
        value += rng.normal() * settings.inner.rate
        seconds += settings.seconds_a_step
        time.sleep(settings.seconds_a_step)
        if settings.fail_with and step == settings.iterations // 2:
            raise DataError(settings.fail_with)
        if settings.crash and step == settings.iterations // 2:
            os._exit(7)
        run.report(step, settings.iterations, {"loss": value})
        if step % settings.checkpoint_steps == 0 or step == settings.iterations:
            state = {"step": step, "value": value, "seconds": seconds}
            write_text(path, json.dumps(state | {"rng": rng.bit_generator.state}))
    if settings.elsewhere:
        run.on_elsewhere(settings.elsewhere, settings.elsewhere)
    run.on_stage("train", seconds)
    return model_of(value, run.backend)


def cost(settings: FakeSettings, scene: Scene) -> Cost:
    """A hundredth of a second and a megabyte a step and training view."""
    work = settings.iterations * len(scene.train)
    return Cost(cpu_seconds=0.01 * work, memory_mb=float(work))


def model_of(value: float, backend: str) -> ExplicitModel:
    """A few Gaussians whose brightness depends on `value`."""
    model = random_gaussians(12, degree=0)
    sh = model.sh + float(np.tanh(value))
    return ExplicitModel(model=replace(model, sh=sh), backend=backend)


def fake_scene(spec: str | Path, protocol: Protocol) -> Scene:
    """Six tiny views, two of them held out; the name "broken" cannot be opened."""
    if str(spec) == "broken":
        raise DataError("broken: no scene found here")
    return replace(
        _drawn(),
        name=Path(spec).name,
        train=(1, 2, 4, 5),
        test=(0, 3),
        facts={"made": "in memory"},
        left_out=(("blurred.jpg", "did not register"),),
    )


@cache
def _drawn() -> Scene:
    """Drawn once a process: a seventh of what a case costs. Views give copies of their photos."""
    return tiny_scene(points=12)


def register() -> None:
    """Make the fake method and its scenes known in this process."""
    METHODS["fake"] = Method(
        name="fake", settings=FakeSettings, fit=fit, cost=cost, description="Trains nothing"
    )
    cases.open_scene = fake_scene


def run_fake_case(job: Job, tell: Tell) -> None:
    """Target for a worker process, which starts without the fake method."""
    register()
    run_case(job, tell)


def run_on_a_full_disk(job: Job, tell: Tell) -> None:
    """Target for a worker process that cannot write its record."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(job.folder / "record.json"))


def run_talking_case(job: Job, tell: Tell) -> None:
    """Target for a worker process: a case that prints."""
    print("a method's own words", flush=True)
    run_fake_case(job, tell)


def run_case_that_leaves_a_thread(job: Job, tell: Tell) -> None:
    """Target for a worker process: a case whose method shows its model in a thread that never ends."""
    Thread(target=Event().wait).start()
    run_fake_case(job, tell)


def settings_table(**values: Any) -> dict[str, Any]:
    """All settings as a result records them."""
    return asdict(FakeSettings(**values))
