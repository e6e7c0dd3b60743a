"""Run a suite: every case once, resumable at any moment, one failing case never stops the others."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

from splatproof.base.errors import DataError, UsageError
from splatproof.base.locks import locked
from splatproof.reference.types.result import Result
from splatproof.suites.records import RECORD_NAME, read_record
from splatproof.suites.run_case import Job, reason_of
from splatproof.suites.scene_data import SceneData, changed, digest
from splatproof.suites.suite_files import Case, Suite, key_of
from splatproof.suites.workers import Launch, in_worker

Status = Literal["kept", "finished", "failed"]
"""kept: it was finished before; finished, failed: it ran now."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a case."""

    case: Case
    folder: Path
    status: Status
    result: Result


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a running case is."""

    case: Case
    index: int
    """Of the case among those of this run, from 0."""
    count: int
    """Cases of this run."""
    stage: str
    """files (hashing the scene's), then "start" with a note why an old result does not count, then
    load, init, train, save, score."""
    step: int = 0
    total: int = 0
    """Training steps, or files; 0 elsewhere."""
    values: dict[str, float] | None = None
    note: str = ""


def select(suite: Suite, *, only: str | None = None, seeds: int | None = None) -> Suite:
    """The suite with fewer cases or other seeds.

    Args:
        suite: As loaded.
        only: Pattern on scene/method/protocol/seed<k>, "*" and "?" as in a shell.
        seeds: Every scene, method and protocol with the seeds 0 to seeds - 1.
    Raises: UsageError if nothing is left.
    """
    cases = suite.cases
    if seeds is not None:
        if seeds < 1:
            raise UsageError(f"--seeds {seeds}: expected 1 or more")
        rows = {case.folder.parent: case for case in cases}.values()
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
    folder: Path,
    *,
    only: str | None = None,
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_result: Callable[[Outcome], None] = lambda _: None,
    backend: str = "cpu",
    threads: int | None = None,
    resume: bool = True,
    workers: int = 1,
    engine: str = "processes",
    launch: Launch = in_worker,
) -> tuple[Outcome, ...]:
    """Run all cases that are not finished yet, one after the other.

    A case is finished if its record was made of these settings, protocol, backend and data. Where
    the data behind the scene's name have changed it runs again, and what it had goes to
    <folder>/<suite>/.replaced/.../seed<k>/<n>.

    Args:
        suite: What to run.
        folder: Results go to <folder>/<suite>/<scene>/<method>/<protocol>/seed<k>/.
        only: See `select`.
        on_progress: Hears where a running case is.
        on_result: Hears what became of each case, kept ones included.
        backend: Name of the rasterizer; part of what makes a result count as this case's.
        threads: Of torch and the kernels; None leaves them alone.
        resume: False starts every case over.
        workers: Blocks of a city that are trained at the same time. Equal blocks of several cases
            are trained once, in <folder>/<suite>/.blocks/.
        engine: Where they are trained, see splatproof.methods.city.executor.
        launch: Runs a job to its record.
    Returns: One outcome a case, in the suite's order.
    Raises: UsageError if `only` matches nothing; also if the folder is in use.
    """
    cases = select(suite, only=only).cases
    outcomes = []
    blocks = folder / suite.name / ".blocks"
    scenes = SceneData(folder / suite.name / ".files.json")
    in_use = (
        f"{folder / suite.name}: another `bench run` is using this folder; wait for it or use --out"
    )
    with locked(folder / suite.name / ".lock", busy=in_use):
        if not resume:
            shutil.rmtree(blocks, ignore_errors=True)
        for index, case in enumerate(cases):
            job = Job(
                case=case,
                suite=suite.name,
                suite_scenes=suite.scenes,
                folder=folder / suite.name / case.folder,
                backend=backend,
                threads=threads,
                resume=resume,
                workers=workers,
                engine=engine,
            )
            here = Progress(case=case, index=index, count=len(cases), stage="start")
            job, unread = _with_data(job, scenes, blocks, here, on_progress)
            found = finished(job) if resume else "starts over"
            if isinstance(found, Result) and (odd := changed(found.scene_facts, job.data)):
                found = f"runs again: {odd} changed since; the old result is in {_set_aside(job)}"
            if isinstance(found, str):
                on_progress(replace(here, note=found))
                outcome = _launch(job, here, on_progress, launch)
            else:
                if unread:
                    on_progress(replace(here, note=f"kept, unchecked: {unread}"))
                outcome = Outcome(case=case, folder=job.folder, status="kept", result=found)
            outcomes.append(outcome)
            on_result(outcome)
    return tuple(outcomes)


def _with_data(
    job: Job,
    scenes: SceneData,
    blocks: Path,
    here: Progress,
    on_progress: Callable[[Progress], None],
) -> tuple[Job, str]:
    """The job with the facts of its data, and why there are none ("" where there are)."""

    def report(done: int, total: int) -> None:
        on_progress(replace(here, stage="files", step=done, total=total))

    try:
        data = scenes.of(job.case.scene, job.case.protocol, report)
    except Exception as error:  # noqa: BLE001 (whatever an adapter raises, the other cases go on)
        return replace(job, cache=blocks / "unread"), reason_of(error)
    return replace(job, data=data, cache=blocks / digest(data)), ""


def _set_aside(job: Job) -> Path:
    """Move the case's folder to where nothing is looked for; returns that place."""
    above = job.folder.parents[3]
    places = above / ".replaced" / job.folder.relative_to(above)
    places.mkdir(parents=True, exist_ok=True)
    place = places / str(1 + len(list(places.iterdir())))
    job.folder.rename(place)
    return place


def finished(job: Job) -> Result | str:
    """The job's result if it is there and counts, else why the case has to run ("" if it is new)."""
    if not (job.folder / RECORD_NAME).exists():
        return "continues" if (job.folder / "case.json").exists() else ""
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
        protocol=result.protocol_rules,
        pose_noise=result.pose_noise,
        backend=result.environment.get("backend"),
    )
    if key != job.key:
        return "runs again: the record in its folder has other settings, protocol, pose noise or backend"
    return result


def _launch(
    job: Job, here: Progress, on_progress: Callable[[Progress], None], launch: Launch
) -> Outcome:
    def tell(stage: str, step: int, total: int, values: dict[str, float]) -> None:
        on_progress(replace(here, stage=stage, step=step, total=total, values=values, note=""))

    launch(job, tell)
    result = read_record(job.folder)
    status = "failed" if result.error else "finished"
    return Outcome(case=job.case, folder=job.folder, status=status, result=result)
