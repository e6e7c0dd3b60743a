"""Run one case: open the scene, train or continue, save, score, and write the record."""

import json
import math
import shutil
import traceback
from contextlib import chdir, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.files import read_text, write_text
from splatproof.base.folders import new_folder
from splatproof.base.memory import peak_memory_mb, peak_within
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.reading_clock import READING
from splatproof.methods.city.model import CityModel
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import Reconstruction, save_model
from splatproof.methods.contracts.run import Run, show_nobody
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.registry import get_method
from splatproof.methods.training.snapshots import Snapshots
from splatproof.methods.training.threads import threads
from splatproof.metrics.registry import load_weights
from splatproof.metrics.scoring import scene_metrics
from splatproof.reference.types.result import BEGAN, BOOT, ENDED, ImageScore, Result, prior_name
from splatproof.reference.types.scene import Scene
from splatproof.suites import appearance
from splatproof.suites import case_costs as measure
from splatproof.suites.case_folder import TRACEBACK, prepare
from splatproof.suites.case_keys import case_key
from splatproof.suites.environment import boot, environment, now
from splatproof.suites.held_out import (
    check_truth,
    render_milliseconds,
    score_views,
    scored_views,
)
from splatproof.suites.marks import Marks, timed_metrics, timed_scores
from splatproof.suites.records import write_record
from splatproof.suites.same_model import CURVE, TRAINED, take_model
from splatproof.suites.scene_scores.city_scores import city_scores, peak_name
from splatproof.suites.scene_scores.true_geometry import geometry_metrics
from splatproof.suites.suite_files import Case
from splatproof.suites.training_curve import Curve
from splatproof.suites.training_gap import training_gap
from splatproof.suites.training_scene import training_scene

CHECKPOINT_SECONDS = 15.0
"""Default seconds of training between two checkpoints; a kill loses at most this much."""
BEGUN_BY = "begun by"
"""The fact of a record that names the code by which a case was begun that other code has ended."""
PACKAGE = f"{__name__.partition('.')[0]}."
"""How the names of our own modules begin."""


@runtime_checkable
class Tell(Protocol):
    """Whoever is told where a case is."""

    def __call__(
        self, stage: str, step: int, total: int, values: dict[str, float], note: str = "", /
    ) -> None:
        """Hear where a case is.

        Args:
            stage: load, priors, init, train, save or score.
            step: Training step that was just done, or number of views with a prior; else 0.
            total: Number of all those steps or views; else 0.
            values: What the method says of the step by name, e.g. its loss.
            note: One line for people that the method says besides.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Job:
    """A case and everything around it that running it takes. Can be sent to another process."""

    case: Case
    suite: str
    """Name of the suite, for the record."""
    suite_scenes: tuple[str, ...]
    """Names of all scenes that the suite declares, for the record."""
    folder: Path
    """The case's own folder."""
    backend: str = "cpu"
    """Name of the rasterizer."""
    threads: int | None = None
    """Threads of torch and the kernels; None leaves them alone."""
    resume: bool = True
    """False: what is in the folder is removed first."""
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    """Seconds of training between two checkpoints."""
    workers: int = 1
    """Blocks of a city that are trained at the same time."""
    image_bytes: int = Run.image_bytes
    """Bytes for photos in memory, see `Run`."""
    engine: str = "processes"
    """Where blocks are trained, see splatproof.methods.city.executor."""
    unscored: bool = False
    """True: a scene without held-out views is trained and not scored. False: it is refused."""
    cache: Path | None = None
    """Where cases of one suite and the same data share trained blocks; None: they do not."""
    same_model: tuple[tuple[Path, str], ...] = ()
    """Folders of cases whose model is this one's too, and their keys: one that is there is taken, not trained."""
    snapshots: Path | None = None
    """Folder that the model is written to now and then while it trains, for who watches; None: nobody."""
    data: dict[str, str] = field(default_factory=dict)
    """Facts of the scene's files, for the record; nothing that was made of other files is
    continued."""

    @property
    def key(self) -> str:
        """What a record or checkpoint must have been made of to count for this job."""
        return case_key(self.case, self.backend)


@dataclass
class Spent:
    """What a case has cost so far."""

    stages: dict[str, float] = field(default_factory=dict)
    """Wall seconds by stage."""
    facts: dict[str, str] = field(default_factory=dict)
    """What the method says of how it was trained."""
    counters: dict[str, int] = field(default_factory=dict)
    """Work that training was, by name."""
    cpu_seconds: float = 0.0
    """CPU seconds of all processes together."""
    peak_memory_mb: float = 0.0
    """Peak resident memory in 2^20 bytes."""
    reading: dict[str, float] = field(default_factory=dict)
    """Wall seconds that reading photos took by part, see splatproof.datasets.reading_clock."""


def run_case(job: Job, tell: Tell) -> None:
    """Run a case to its record.json; a failure is recorded too, with its reason in one line.

    A folder of other settings or data is emptied first; one of these is continued: from the
    saved model if training had ended, else from the method's last checkpoint.

    Args:
        job: What to run, and where.
        tell: Hears where the case is.
    """
    job = replace(job, folder=job.folder.absolute())  # a method may change the current folder
    try:
        with threads(job.threads):
            made_of = {
                "key": job.key,
                "case": job.case.label,
                "backend": job.backend,
                "data": job.data,
            }
            begun_by = prepare(job.folder, made_of, asdict(job.case.origin), resume=job.resume)
            _run(job, tell, begun_by)
    except Exception as error:  # noqa: BLE001 (whatever a method raises, the other cases go on)
        with suppress(OSError):  # a full disk: the record's one line comes first
            write_text(job.folder / TRACEBACK, traceback.format_exc())
        write_record(job.folder, failed_result(job, reason_of(error)))


def reason_of(error: BaseException) -> str:
    """Say in one line why a case failed."""
    line = " ".join(str(error).split())
    return line if isinstance(error, SplatproofError) else f"{type(error).__name__}: {line}"


def failed_result(job: Job, reason: str) -> Result:
    """Make the record of a case that has no numbers.

    Args:
        job: What was to be run.
        reason: One line that says why it failed.
    Returns: A result with no images and no metrics.
    """
    return Result(
        **_identity(job), images=(), metrics={}, stages={}, cpu_seconds=0.0, peak_memory_mb=0.0,
        primitives=0, bytes_on_disk=0, render_ms=float("nan"), split_sha256="", model_sha256="",
        error=reason,
    )  # fmt: skip


def _run(job: Job, tell: Tell, begun_by: str) -> None:
    weights = load_weights(job.case.protocol.metrics)
    spent = Spent()
    read = READING.seconds()
    tell("load", 0, 0, {})
    if begun_by:
        line = f"begun by other code ({begun_by}), which the record says; --no-resume starts over"
        tell("load", 0, 0, {}, line)
    with measure.timed(spent.stages, "load"):
        scene = open_scene(job.case.scene, job.case.protocol)
        if scene.test or not job.unscored:
            check_truth(scene, job.case.protocol)  # what cannot be scored is not trained
        # scores are of the true scene
        given = training_scene(
            scene,
            job.case,
            job.data,
            lambda done, total: tell("priors", done, total, {}),
            lambda line: tell("priors", 0, 0, {}, line),
        )
    done = job.folder / TRAINED
    if not done.exists():
        take_model(job.folder, job.same_model, job.data, job.case.origin)
    curve = Curve(job.folder / CURVE)
    if not done.exists():
        _train(job, given, curve, spent, tell)
        cpu, peak = curve.spent()
        spent.cpu_seconds += cpu
        spent.reading = READING.since(read)
        spent.peak_memory_mb = max(spent.peak_memory_mb, peak)
        write_text(done, json.dumps(asdict(spent)))
    before = Spent(**json.loads(read_text(done)))
    shutil.rmtree(job.folder / "checkpoint", ignore_errors=True)
    tell("score", 0, 0, {})
    started = measure.cpu_seconds()
    # What is scored is what lies on disk, so a continued case and an undisturbed one agree.
    model = load_reconstruction(job.folder / "model", backend=job.backend)
    taken: dict[str, float] = {}
    with measure.timed(before.stages, "score"), peak_within(taken, peak_name("score")):
        images, means, render_ms, drawn = _scores(job, scene, model, tell)
        timed = ()
        if job.case.marks and scene.test:
            timed = timed_scores(
                job.folder, job.case.marks, scene, job.case.protocol, job.backend, means
            )
            means |= timed_metrics(job.case.marks, timed)
            means |= {f"{part}_seconds": spent for part, spent in before.reading.items()}
    if isinstance(model, CityModel) and scene.test:
        means |= taken
    identity = _identity(job)
    identity["environment"] |= {f"weights of {name}": sha for name, sha in weights.items()}
    identity["environment"] |= before.facts | {
        "appearance": appearance.told(model, job.case.protocol, scene)
    }
    if begun_by:
        identity["environment"] |= {BEGUN_BY: begun_by}
    result = Result(
        **identity,
        images=images,
        metrics=means,
        stages=before.stages,
        cpu_seconds=before.cpu_seconds + measure.cpu_seconds() - started,
        peak_memory_mb=max(before.peak_memory_mb, peak_memory_mb()),
        primitives=model.primitives,
        bytes_on_disk=measure.bytes_on_disk(job.folder / "model"),
        render_ms=render_ms,
        split_sha256=measure.split_sha256(scene),
        model_sha256=measure.arrays_sha256(job.folder / "model"),
        curve=curve.points(),
        curve_seconds=curve.seconds(),
        timed=timed,
        counters=before.counters | drawn,
        scene_facts=given.facts | job.data,
        left_out=scene.left_out,
    )
    write_record(job.folder, result)


def _scores(
    job: Job, scene: Scene, model: Reconstruction, tell: Tell
) -> tuple[tuple[ImageScore, ...], dict[str, float], float, dict[str, int]]:
    """The scores of each held-out view, those of the scene, milliseconds a frame, and counters."""
    if not scene.test:
        return (), {}, math.nan, {}
    backend, rules = get_backend(job.backend), job.case.protocol
    listed = backend.pairs()
    images = score_views(
        scene, model, rules, job.folder, lambda done, total: tell("score", done, total, {})
    )
    drawn = {"render_pairs": backend.pairs() - listed} if backend.counts_pairs else {}
    render_ms = render_milliseconds(
        scored_views(scene, rules), model, torch.tensor(rules.background)
    )
    means = scene_metrics(images) | geometry_metrics(scene, model)
    means |= training_gap(scene, model, rules, images)
    if isinstance(model, CityModel):
        images, extra = city_scores(scene, model, rules, images, job.folder)
        means |= extra
    return images, means, render_ms, drawn


def _train(job: Job, scene: Scene, curve: Curve, spent: Spent, tell: Tell) -> None:
    """Fit the method, or continue it, and save the model."""
    method = get_method(job.case.method)

    def number(what: str, value: Any) -> float:
        with suppress(TypeError, ValueError):
            if not isinstance(value, str):
                return float(value)
        raise UsageError(f"method {method.name}: {what} is {value!r:.60}, expected a number")

    def report(step: int, total: int, values: dict[str, Any]) -> None:
        numbers = {name: number(f"the reported {name!r}", value) for name, value in values.items()}
        curve.add(int(step), int(total), numbers)
        tell("train", int(step), int(total), numbers)

    def staged(stage: str, seconds: float) -> None:
        spent.stages[stage] = number(f"the time of stage {stage!r}", seconds)
        if not 0 <= spent.stages[stage] < math.inf:
            raise UsageError(f"method {method.name}: stage {stage!r} took {seconds} s")

    tell("init", 0, 0, {})
    watch = show_nobody if job.snapshots is None else Snapshots(job.snapshots)
    if job.case.marks:
        before = max((spent.stages["load"], *curve.seconds()[-1:]))
        watch = Marks(job.folder, job.case.marks, before, watch)

    def elsewhere(cpu_seconds: float, peak_mb: float) -> None:
        spent.cpu_seconds, spent.peak_memory_mb = cpu_seconds, peak_mb

    spent.facts |= {BEGAN: now(), BOOT: boot()}
    with chdir("."):
        model = method.fit(
            scene.for_training(),
            job.case.settings,
            Run(
                folder=job.folder,
                seed=job.case.seed,
                backend=job.backend,
                threads=job.threads,
                background=job.case.protocol.background,
                report=report,
                on_stage=staged,
                on_fact=spent.facts.__setitem__,
                on_count=spent.counters.__setitem__,
                on_elsewhere=elsewhere,
                checkpoint_seconds=job.checkpoint_seconds,
                image_bytes=job.image_bytes,
                workers=job.workers,
                engine=job.engine,
                cache=job.cache,
                say=lambda line: tell("train", 0, 0, {}, line),
                on_model=watch,
            ),
        )
    spent.facts[ENDED] = now()
    if not isinstance(model, Reconstruction):
        raise UsageError(
            f"method {method.name}: fit returned a {type(model).__name__}, expected a Reconstruction, "
            "e.g. an ExplicitModel"
        )
    tell("save", 0, 0, {})
    with measure.timed(spent.stages, "save"), new_folder(job.folder / "model") as folder:
        save_model(model, folder, job.case.origin)
        _check_kept(model, folder, job)


def _check_kept(model: Reconstruction, folder: Path, job: Job) -> None:
    """Refuse a class of somebody else's that is loaded as another: what is scored would not be it."""
    made = type(model)
    if made.__module__.startswith(PACKAGE):  # ours come back as they were
        return
    again = type(load_reconstruction(folder, backend=job.backend))
    if again is not made:
        raise UsageError(
            f"method {job.case.method}: fit returned a {made.__name__} of kind {model.kind!r}, which is "
            f"loaded as a {again.__name__}, and what is loaded is scored; give it a kind of its own "
            "and that a loader (Method.loaders)"
        )


def _identity(job: Job) -> dict:
    """The fields that a result has before anything has run."""
    return {
        "suite": job.suite,
        "suite_scenes": job.suite_scenes,
        "scene": job.case.scene_name,
        "method": job.case.method,
        "variant": job.case.variant,
        "pose_noise": job.case.pose_noise,
        "depth_prior": prior_name(job.case.depth_prior),
        "seed": job.case.seed,
        "protocol": job.case.protocol.name,
        "protocol_rules": asdict(job.case.protocol),
        "settings": asdict(job.case.settings),
        "environment": environment(job.backend),
    }
