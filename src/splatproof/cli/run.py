"""`bench run SUITE`: all cases of a suite, then the tracking store and the leaderboard."""

from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.flags import and_plugins
from splatproof.cli.running import (
    USUAL,
    USUAL_BLOCKS,
    BlockRunning,
    Running,
    Screen,
    check_options,
    exit_code,
    of_other_code,
    options,
    prepare,
    record,
)

if TYPE_CHECKING:
    from splatproof.suites.runner import Outcome
    from splatproof.suites.suite_files import Suite


def run(
    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")],
    *,
    out: Path = Path("runs"),
    only: str | None = None,
    seeds: int | None = None,
    width: int | None = None,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    dry_run: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    running: Annotated[Running, tyro.conf.arg(name="")] = USUAL,
    blocks: Annotated[BlockRunning, tyro.conf.arg(name="")] = USUAL_BLOCKS,
) -> int:
    """Run every scene x method x protocol x seed of a suite, and print the leaderboard.

    A finished case is never repeated unless its settings, protocol, backend or the scene's files have
    changed; an unfinished one continues from its last checkpoint, however it was stopped. A case
    that fails is recorded with its reason, and the others go on. Each case is logged to the tracking
    store (MLFLOW_TRACKING_URI, else OUT/mlflow.db).

    With --json each case is a line: suite, scene, method, variant, pose_noise, depth_prior, protocol,
    seed, status (kept, finished, failed), error, folder, every metric by its name, seconds by
    stage, primitives, bytes_on_disk, peak_memory_mb, render_ms. With --dry-run too the line has
    estimated_seconds, estimated_memory_mb, basis and missing instead of results.

    Args:
        suite: Name of a suite, or the path of a .toml file.
        out: Folder for the results; each case has its own in OUT/SUITE/SCENE/METHOD/PROTOCOL/seedK.
        only: Run only the cases that match this pattern on scene/method/protocol/seed, e.g.
            "town/*/seed0".
        seeds: Run each case with the seeds 0 to N - 1 instead of the suite's own.
        width: Width of the images in pixels, in training and in scoring. None: the protocols' own.
        quick: Run the suite's reduced form, which is the suite SUITE-quick.
        dry_run: Print the cases, their estimated time and memory, and how to get the scenes that
            are not on this machine. Runs, makes and writes nothing.
        running: How cases are run.
        blocks: How blocks of a city are trained.
    """
    from splatproof.cli.report import print_tables, sync_cases
    from splatproof.metrics.protocol_files import resized
    from splatproof.reports.leaderboard import build_tables
    from splatproof.reports.mlflow_client import default_uri
    from splatproof.suites.runner import run_suite, select
    from splatproof.suites.scenes import without_absent
    from splatproof.suites.suite_files import load_suite, quick_form

    uri = default_uri(out)
    _check_name(suite)
    whole = load_suite(quick_form(suite) if quick else suite)
    if width is not None:
        whole = replace(whole, cases=tuple(
            replace(case, protocol=resized(case.protocol, width)) for case in whole.cases
        ))  # fmt: skip
    chosen = select(whole, only=only, seeds=seeds)
    if dry_run:
        return _print_plan(chosen, out, running, blocks)
    chosen, absent = without_absent(chosen)
    check_options(chosen, running, blocks)
    prepare(chosen)
    for reason in absent:
        output.log(f"left out: {reason}")
    with output.progress() as bar:
        screen = Screen(bar, _print_record)
        outcomes = run_suite(
            chosen, out, planned=whole.cases, on_progress=screen.progress, on_result=screen.result,
            **options(running, blocks),
        )  # fmt: skip
    if older := of_other_code(outcomes):
        output.warn(older)
    if sync_cases(out / whole.name, uri):
        output.warn("the records are on disk; the next `bench run` or `bench report` logs them")
    if not output.wants_json():
        print_tables(build_tables(outcome.result for outcome in outcomes))
        page = f"bench report --out {quote(str(out))}{and_plugins()}"
        output.log(f"records: {out / whole.name}; page with pictures: {page}")
    return exit_code(outcomes)


def _check_name(suite: str) -> None:
    """Tell apart the names of suites and those of studies.

    Raises: UsageError for a study, or a name that is near to one's.
    """
    from splatproof.suites.suite_files import suite_names

    if suite.endswith(".toml") or suite in suite_names():
        return
    from splatproof.suites.studies.study import STUDIES  # they load what draws their pictures

    if suite in STUDIES:
        raise UsageError(f"{suite} is a study, not a suite: run `bench study {suite}`")
    near = get_close_matches(suite, [*suite_names(), *STUDIES], n=1, cutoff=0.6)
    if near and near[0] in STUDIES:
        raise UsageError(f"suite: unknown {suite!r}, did you mean `bench study {near[0]}`?")


def _print_record(outcome: "Outcome") -> None:
    if output.wants_json():
        output.print_record(record(outcome))


def _print_plan(suite: "Suite", out: Path, running: Running, blocks: BlockRunning) -> int:
    """Print each case with its estimates, and what has to be got or made for the others."""
    from splatproof.reference.types.result import prior_name
    from splatproof.suites.estimate import estimate_suite
    from splatproof.suites.scenes import absences, not_made, without_side_effects

    absent, unmade = absences(suite), not_made(suite)
    known = {case.scene for case in suite.cases} - {*absent, *unmade}
    here = replace(suite, cases=tuple(c for c in suite.cases if c.scene in known))
    check_options(suite, running, blocks)
    guesses = iter(estimate_suite(without_side_effects(here), out, running.backend))
    total = 0.0
    for case in suite.cases:
        guess = next(guesses) if case.scene in known else None
        total += guess.seconds if guess else 0.0
        basis = "scene not made yet" if case.scene in unmade else "scene not on this machine"
        line = {
            "suite": suite.name,
            "scene": case.scene_name,
            "method": case.method,
            "variant": case.variant,
            "pose_noise": case.pose_noise,
            "depth_prior": prior_name(case.depth_prior),
            "protocol": case.protocol.name,
            "seed": case.seed,
            "estimated_seconds": guess.seconds if guess else None,
            "estimated_memory_mb": guess.memory_mb if guess else None,
            "basis": guess.basis if guess else basis,
            "missing": absent.get(case.scene, ""),
        }
        costs = (
            f"{guess.seconds:8.0f} s {guess.memory_mb:8.0f} MB"
            if guess
            else f"{'not made' if case.scene in unmade else 'not here':>22}"
        )
        output.emit(line, f"{costs}  {case.label}  ({line['basis']})")
    for reason in absent.values():
        output.log(f"not here: {reason}")
    for scene in unmade:
        output.log(
            f"not made: {scene}: the run makes it first; `bench scenes get {scene}` makes it now"
        )
    away = sum(case.scene in absent for case in suite.cases)
    output.log(
        f"{len(suite.cases)} cases: {len(here.cases)} take about {total:.0f} s one after the other, "
        f"{len(suite.cases) - len(here.cases) - away} wait for scenes to be made and have no "
        f"estimate, {away} cannot run here"
    )
    return 0
