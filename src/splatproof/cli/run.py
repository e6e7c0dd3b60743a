"""`bench run SUITE`: all cases of a suite, then the tracking store and the leaderboard."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from splatproof.suites.runner import Outcome, Progress
    from splatproof.suites.suite_files import Suite


def run(
    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")],
    *,
    out: Path = Path("runs"),
    only: str | None = None,
    seeds: int | None = None,
    dry_run: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    resume: bool = True,
    backend: str = "cpu",
    threads: int | None = None,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    wait: float = 300.0,
    page: Path | None = None,
    rows: Path | None = None,
    workers: int | None = None,
    engine: str = "processes",
) -> int:
    """Run every scene x method x protocol x seed of a suite, and print the leaderboard.

    The studies stability, partition, memory and speed print rows instead: with --json a row a line,
    kept in OUT/<study>.jsonl too; exit code 1 if a row is over its budget.

    A finished case is never repeated unless its settings, protocol, backend or the scene's files have
    changed; an unfinished one continues from its last checkpoint, however it was stopped. With --json each case is
    a line: suite, scene, method, protocol, seed, status (kept, finished, failed), error, folder, every
    metric by its name, seconds by stage, primitives, bytes_on_disk, peak_memory_mb, render_ms.

    Args:
        suite: Name of a suite or a study, or the path of a .toml file.
        out: Folder for the results; each case has its own in OUT/SUITE/scene/method/protocol/seed.
        only: Run the cases that match this pattern on scene/method/protocol/seed, e.g. "town/*/seed0".
        seeds: Run the seeds 0 to N - 1 instead of the suite's.
        dry_run: Print the cases with estimated time and memory, and how to get the scenes that are
            not on this machine; run nothing.
        resume: Keep what is there (--no-resume: start the chosen cases over).
        backend: Rasterizer: cpu, reference or cuda.
        threads: Threads to use; None: as many as torch does.
        quick: Reduced form of a study, or of a suite that has one: the suite SUITE-quick.
        wait: Seconds that study speed may lose to other processes; then it refuses rows.
        page: Also write the study's Markdown page to this file, with its rows as JSON beside it.
        rows: Make the page of the rows in this JSON file instead of measuring.
        workers: Blocks of a city that are trained at the same time; None: one a core.
        engine: Where the blocks of a city are trained: processes, inline or ray.
    """
    from splatproof.suites.studies.study import STUDIES

    if suite in STUDIES:
        from splatproof.cli.study import run_study

        return run_study(
            suite, out, quick=quick, wait=wait, backend=backend, page=page, recorded=rows
        )
    if page is not None or rows is not None:
        raise UsageError(f"--page and --rows are for the studies {', '.join(STUDIES)}")
    from splatproof.base.names import unknown
    from splatproof.cli.report import print_tables, sync_cases
    from splatproof.methods.backends import get_backend
    from splatproof.metrics.registry import load_weights
    from splatproof.reports.leaderboard import build_tables
    from splatproof.reports.mlflow_client import default_uri
    from splatproof.suites.environment import usable_cores
    from splatproof.suites.runner import run_suite, select
    from splatproof.suites.scenes import absences, make_scenes, without_absent
    from splatproof.suites.suite_files import load_suite, quick_form, suite_names

    uri = default_uri(out)
    if suite not in suite_names() and not suite.endswith(".toml"):
        raise unknown("suite or study", suite, [*suite_names(), *STUDIES])
    whole = load_suite(quick_form(suite) if quick else suite)
    get_backend(backend)
    chosen = select(whole, only=only, seeds=seeds)
    missing: dict[str, str] = {}
    if dry_run:
        missing = absences(chosen)
        here = tuple(case for case in chosen.cases if case.scene not in missing)
    else:
        chosen, absent = without_absent(chosen)
        here = chosen.cases
        load_weights({metric for case in here for metric in case.protocol.metrics})
        for reason in absent:
            output.log(f"left out: {reason}")
    with output.progress() as bar:
        task = bar.add_task("making scenes", total=None, values="")
        make_scenes(
            replace(chosen, cases=here),
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    if dry_run:
        return _print_plan(chosen, missing, out, backend)
    with output.progress() as bar:
        screen = _Screen(bar)
        outcomes = run_suite(
            chosen, out, backend=backend, threads=threads, resume=resume, engine=engine,
            workers=usable_cores() if workers is None else workers,
            on_progress=screen.progress, on_result=screen.result,
        )  # fmt: skip
    if sync_cases(out / whole.name, uri):
        output.warn("the records are on disk; the next `bench run` or `bench report` logs them")
    if not output.wants_json():
        print_tables(build_tables(outcome.result for outcome in outcomes))
        output.log(f"records: {out / whole.name}; page with pictures: bench report --out {out}")
    return int(any(outcome.status == "failed" for outcome in outcomes))


class _Screen:
    """What a person sees while cases run, on stderr; with --json also a line a case on stdout."""

    def __init__(self, bar: "Bar") -> None:
        """Add one task to the bar, for the running case."""
        self._bar = bar
        self._task = bar.add_task("", total=None, values="")

    def progress(self, at: "Progress") -> None:
        """Show where the case is."""
        if at.stage == "start":
            note = f" {at.note}" if at.note else ""
            output.log(f"[{at.index + 1}/{at.count}] {at.case.label}{note}")
            self._bar.reset(self._task, total=None, description=at.case.label, values="")
        values = "  ".join(f"{name} {value:.4g}" for name, value in (at.values or {}).items())
        self._bar.update(
            self._task,
            completed=at.step,
            total=at.total or None,
            description=f"{at.case.label} {at.stage}",
            values=values,
        )

    def result(self, outcome: "Outcome") -> None:
        """Tell what became of the case."""
        result, case = outcome.result, outcome.case
        if output.wants_json():
            output.print_record(_record(outcome))
        if result.error:
            output.warn(f"{case.label} failed: {result.error} (folder {outcome.folder})")
            return
        shown = "  ".join(f"{name} {result.metrics[name]:.4g}" for name in case.protocol.metrics)
        spent = sum(result.stages.values())
        output.log(f"{outcome.status}: {case.label}  {shown}  {spent:.1f} s")


def _record(outcome: "Outcome") -> dict[str, object]:
    result = outcome.result
    return {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "pose_noise": result.pose_noise,
        "protocol": result.protocol,
        "seed": result.seed,
        "status": outcome.status,
        "error": result.error,
        "folder": str(outcome.folder),
        **result.metrics,
        "seconds": result.stages,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "peak_memory_mb": result.peak_memory_mb,
        "render_ms": result.render_ms,
    }


def _print_plan(suite: "Suite", missing: dict[str, str], out: Path, backend: str) -> int:
    """Print each case with its estimates, and what has to be got for those that cannot run."""
    from splatproof.suites.estimate import estimate_suite

    here = replace(suite, cases=tuple(c for c in suite.cases if c.scene not in missing))
    guesses = iter(estimate_suite(here, out, backend))
    total = 0.0
    for case in suite.cases:
        guess = None if case.scene in missing else next(guesses)
        total += guess.seconds if guess else 0.0
        record = {
            "suite": suite.name,
            "scene": case.scene_name,
            "method": case.method,
            "variant": case.variant,
            "pose_noise": case.pose_noise,
            "protocol": case.protocol.name,
            "seed": case.seed,
            "estimated_seconds": guess.seconds if guess else None,
            "estimated_memory_mb": guess.memory_mb if guess else None,
            "basis": guess.basis if guess else "scene not on this machine",
            "missing": missing.get(case.scene, ""),
        }
        costs = (
            f"{guess.seconds:8.0f} s {guess.memory_mb:8.0f} MB" if guess else f"{'not here':>22}"
        )
        output.emit(record, f"{costs}  {case.label}  ({record['basis']})")
    for reason in missing.values():
        output.log(f"not here: {reason}")
    output.log(
        f"{len(suite.cases)} cases, {len(here.cases)} can run here: about {total:.0f} s one after "
        "the other"
    )
    return 0
