"""Run a suite: every case once, resumable at any moment, one failing case never stops the others."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

from splatproof.base.errors import DataError, UsageError
from splatproof.base.locks import locked
from splatproof.base.numbers import in_range
from splatproof.methods.dpgs.refiners import refiner_facts
from splatproof.methods.priors.kinds import weights_facts
from splatproof.methods.stratosplat.own_prior import completion_facts
from splatproof.methods.training.matchers import matcher_facts
from splatproof.reference.types.protocol import key_rules
from splatproof.reference.types.result import Result
from splatproof.suites.case_keys import case_key, key_of, prior_part
from splatproof.suites.chosen_folder import check_chosen
from splatproof.suites.plugin_facts import plugin_facts
from splatproof.suites.records import RECORD_NAME, read_record, write_record
from splatproof.suites.run_case import CHECKPOINT_SECONDS, Job, failed_result, reason_of
from splatproof.suites.same_model import CASE_NAME, made_of, training_key
from splatproof.suites.scene_data import SceneData, changed, digest
from splatproof.suites.suite_files import MOST_CASES, Case, Suite
from splatproof.suites.workers import Launch, in_worker

FILES_NAME = ".files.json"
"""File that remembers the hashes of the scenes' files."""
Status = Literal["kept", "finished", "failed"]
"""kept: it was finished before; finished, failed: it ran now."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a case."""

    case: Case
    folder: Path
    """The case's own folder."""
    status: Status
    result: Result


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a running case is."""

    case: Case
    index: int
    """Number of the case among those of this run, from 0."""
    count: int
    """Number of cases of this run."""
    stage: str
    """"files" while those of the scene are hashed, then "start" with a note why an old result does
    not count, then load, priors, init, train, save, score."""
    step: int = 0
    """Training steps that are done, views that have their prior, or files that are hashed; 0 in other stages."""
    total: int = 0
    """Number of all those steps, views or files; 0 in other stages."""
    values: dict[str, float] | None = None
    """What the method says of its last step by name, e.g. the loss."""
    note: str = ""
    """One line for people."""


def _busy(folder: Path) -> str:
    """What a user is told where another process is at work in the folder."""
    return (
        f"{folder}: another `bench` is at work in this folder; wait for it to end, or take another "
        "folder with --out"
    )


def select(suite: Suite, *, only: str | None = None, seeds: int | None = None) -> Suite:
    """The suite with fewer cases or other seeds.

    Args:
        suite: Suite to choose from.
        only: Pattern on scene/method/protocol/seed<k>, "*" and "?" as in a shell; None: all cases.
        seeds: Every scene, method and protocol with the seeds 0 to seeds - 1; None: the suite's own.
    Returns: The suite with what was chosen.
    Raises: UsageError if nothing is left.
    """
    cases = suite.cases
    if seeds is not None:
        rows = {case.folder.parent: case for case in cases}.values()
        in_range(seeds, "--seeds", 1, MOST_CASES // max(len(rows), 1))
        cases = tuple(replace(case, seed=seed) for case in rows for seed in range(seeds))
    if only is not None:
        kept = tuple(case for case in cases if fnmatch(case.label, only))
        if not kept:
            raise UsageError(
                f"--only {only!r} matches none of the {len(cases)} cases, e.g. {cases[0].label!r}"
            )
        cases = kept
    return replace(suite, cases=cases)


def run_suite(
    suite: Suite,
    folder: str | Path,
    *,
    planned: Sequence[Case] = (),
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_result: Callable[[Outcome], None] = lambda _: None,
    backend: str = "cpu",
    threads: int | None = None,
    resume: bool = True,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    workers: int = 1,
    engine: str = "processes",
    launch: Launch = in_worker,
) -> tuple[Outcome, ...]:
    """Run all cases that are not finished yet, one after the other.

    Cases that differ in the rules of scoring alone are trained once, see `training_key`, also where
    one of them is run now and another was before. A case is finished if its record was made of these
    settings, protocol, backend and data. Where the data behind the scene's name have changed it runs again, and what it had goes to
    <folder>/<suite>/.replaced/.../seed<k>/<n>.

    Args:
        suite: What to run.
        folder: Results go to <folder>/<suite>/<scene>/<method>/<protocol>/seed<k>/.
        planned: Cases that are not run now, where `suite` is a choice of them: models are taken of those that
            ran another time.
        on_progress: Hears where a running case is.
        on_result: Hears what became of each case, kept ones included.
        backend: Name of the rasterizer; part of what makes a result count as this case's.
        threads: Threads of torch and the kernels; None leaves them alone.
        resume: False starts every case over.
        checkpoint_seconds: Seconds of training between two checkpoints.
        workers: Blocks of a city that are trained at the same time. Equal blocks of several cases
            are trained once, in <folder>/<suite>/.blocks/.
        engine: Where blocks are trained, see splatproof.methods.city.executor.
        launch: Runs a job to its record.
    Returns: One outcome a case, in the suite's order.
    Raises: UsageError if another process is at work in the folder.
    """
    folder = Path(folder)
    cases = suite.cases
    outcomes = []
    root = folder / suite.name
    blocks = root / ".blocks"
    scenes = SceneData(root / FILES_NAME)
    with locked(root / ".lock", busy=_busy(root)):
        if not resume:
            shutil.rmtree(blocks, ignore_errors=True)
        models: dict[str, dict[Path, str]] = {}
        for case in (*planned, *cases) if resume else ():
            same = models.setdefault(training_key(case, backend), {})
            same[root / case.folder] = case_key(case, backend)
        for index, case in enumerate(cases):
            same = models.setdefault(training_key(case, backend), {})
            job = Job(
                case=case, suite=suite.name, suite_scenes=suite.scenes, folder=root / case.folder,
                backend=backend, threads=threads, resume=resume,
                checkpoint_seconds=checkpoint_seconds, workers=workers, engine=engine,
                same_model=tuple(one for one in same.items() if one[0] != root / case.folder),
            )  # fmt: skip
            same[job.folder] = job.key
            here = Progress(case=case, index=index, count=len(cases), stage="start")
            job, unread = _with_data(job, scenes, here, on_progress)
            job = replace(job, cache=blocks / ("unread" if unread else digest(job.data)))
            found = finished(job) if resume else "starts over"
            if isinstance(found, Result) and (odd := changed(found.scene_facts, job.data)):
                found = f"runs again: {odd} changed since; the old result is in {_set_aside(job)}"
            outcome = _run_or_keep(job, found, unread, here, on_progress, launch)
            outcomes.append(outcome)
            on_result(outcome)
    return tuple(outcomes)


def run_alone(
    job: Job,
    *,
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_result: Callable[[Outcome], None] = lambda _: None,
    launch: Launch = in_worker,
) -> Outcome:
    """Run one case in a folder that the user chose, as `run_suite` does; `bench fit` is this.

    What lies there is continued or kept if it was made of these settings, protocol, backend and
    data, and is never replaced unasked: a folder that a user names holds what they want to keep.

    Args:
        job: What to run. With resume = False what an earlier run left in its folder is removed.
        on_progress: Hears where the case is.
        on_result: Hears what became of it, also where it was kept.
        launch: Runs a job to its record.
    Returns: What became of the case.
    Raises: UsageError if the folder holds something else, or another process is at work in it.
    """
    check_chosen(job)
    here = Progress(case=job.case, index=0, count=1, stage="start")
    with locked(job.folder / ".lock", busy=_busy(job.folder)):
        job, unread = _with_data(job, SceneData(job.folder / FILES_NAME), here, on_progress)
        if job.resume and (odd := changed(made_of(job.folder).get("data", {}), job.data)):
            raise UsageError(
                f"{job.folder}: {odd} changed since this was trained; take another folder, or start "
                "over in this one with --no-resume"
            )
        found = finished(job) if job.resume else "starts over"
        outcome = _run_or_keep(job, found, unread, here, on_progress, launch)
        on_result(outcome)
    return outcome


def _run_or_keep(
    job: Job,
    found: Result | str,
    unread: str,
    here: Progress,
    on_progress: Callable[[Progress], None],
    launch: Launch,
) -> Outcome:
    """Run the case if its result was not found, saying why; else keep the result."""
    if isinstance(found, str):
        on_progress(replace(here, note=found))
        if unread and made_of(job.folder).get("data"):  # begun of data that may come back
            write_record(job.folder, failed_result(job, unread))
            return _ended(job)
        return _launch(job, here, on_progress, launch)
    if unread:
        on_progress(replace(here, note=f"kept, unchecked: {unread}"))
    return Outcome(case=job.case, folder=job.folder, status="kept", result=found)


def _with_data(
    job: Job,
    scenes: SceneData,
    here: Progress,
    on_progress: Callable[[Progress], None],
) -> tuple[Job, str]:
    """The job with the facts of its data, and why there are none ("" where there are)."""

    def report(done: int, total: int) -> None:
        on_progress(replace(here, stage="files", step=done, total=total))

    try:
        data = scenes.of(job.case.scene, job.case.protocol, report)
        data = data | weights_facts(job.case.depth_prior) | refiner_facts(job.case.settings)
        data = data | matcher_facts(job.case.settings) | completion_facts(job.case.settings)
        data = data | plugin_facts(job.case)
    except Exception as error:  # noqa: BLE001 (whatever an adapter raises, the other cases go on)
        return job, reason_of(error)
    return replace(job, data=data), ""


def _set_aside(job: Job) -> Path:
    """Move the case's folder to where nothing is looked for; returns that place."""
    above = job.folder.parents[3]
    places = above / ".replaced" / job.folder.relative_to(above)
    places.mkdir(parents=True, exist_ok=True)
    taken = [int(path.name) for path in places.iterdir() if path.name.isdecimal()]
    place = places / str(1 + max(taken, default=0))
    job.folder.rename(place)
    return place


def finished(job: Job) -> Result | str:
    """The job's result if it is there and counts, else why the case has to run ("" if it is new)."""
    if not (job.folder / RECORD_NAME).exists():
        return "continues" if (job.folder / CASE_NAME).exists() else ""
    try:
        result = read_record(job.folder)
    except DataError as error:
        return f"runs again: {error}"
    if result.error:
        return f"runs again: it failed before ({result.error})"
    key = key_of(
        scene=result.scene,
        method=result.method,
        settings=result.settings,
        seed=result.seed,
        protocol=key_rules(result.protocol_rules),
        pose_noise=result.pose_noise,
        backend=result.environment.get("backend"),
        **prior_part(result.depth_prior),
    )
    if key != job.key:
        return (
            "runs again: the record in its folder has other settings, protocol, pose noise, depth "
            "prior or backend"
        )
    return result


def _launch(
    job: Job, here: Progress, on_progress: Callable[[Progress], None], launch: Launch
) -> Outcome:
    def tell(stage: str, step: int, total: int, values: dict[str, float], note: str = "") -> None:
        on_progress(replace(here, stage=stage, step=step, total=total, values=values, note=note))

    launch(job, tell)
    return _ended(job)


def _ended(job: Job) -> Outcome:
    """What the record in the folder says of a case that ran now."""
    result = read_record(job.folder)
    status = "failed" if result.error else "finished"
    return Outcome(case=job.case, folder=job.folder, status=status, result=result)
