"""`bench frames SUITE`: milliseconds a frame of saved models, drawn in turns."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.cli import output
from splatproof.cli.running import case_of

if TYPE_CHECKING:
    from splatproof.suites.frames_in_turns import Drawn


def frames(
    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")],
    *,
    out: Path = Path("runs"),
    only: str | None = None,
    rounds: int = 15,
    threads: int | None = None,
) -> int:
    """Time a frame of a suite's saved models in turns, and write it into their records.

    `bench run` times a model's frames right after its training, when other cases, or other people's
    work, may share the machine; rows are then compared by what the machine did meanwhile. Here all
    finished models of a scene and protocol are loaded and draw its held-out views one after the
    other, round by round, so that whatever slows the machine slows all of them. What counts is the
    median over the rounds. Records keep everything else; `bench claims` and `bench report` use the new times, and a
    claim about times of rows that had their turns together is judged even where their training shared the machine.

    With --json each case is a line: suite, scene, method, variant, pose_noise, depth_prior, protocol,
    seed, render_ms, before (what the record had) and rounds (milliseconds in each).

    Args:
        suite: Name of a suite, or the path of a .toml file.
        out: Folder that the suite was run to.
        only: Draw only the cases that match this pattern on scene/method/protocol/seed, e.g.
            "street/*/street/*". None: all finished ones.
        rounds: Turns of each model.
        threads: Threads of torch and the kernels. None: as many as torch takes by itself.
    """
    from splatproof.base.locks import locked
    from splatproof.base.numbers import in_range
    from splatproof.cli.report import sync_cases
    from splatproof.methods.training.threads import threads as threads_of
    from splatproof.reports.mlflow_client import default_uri
    from splatproof.suites.frames_in_turns import LEAST_ROUNDS, draw_in_turns, finished_cases
    from splatproof.suites.runner import select
    from splatproof.suites.suite_files import load_suite

    in_range(rounds, "--rounds", LEAST_ROUNDS)
    if threads is not None:
        in_range(threads, "--threads", 1)
    chosen = select(load_suite(suite), only=only)
    finished_cases(chosen, out)  # before a lock makes folders
    busy = f"{out / chosen.name}: another `bench` is at work in this folder; wait for it to end"
    with (
        locked(out / chosen.name / ".lock", busy=busy),
        threads_of(threads),
        output.progress() as bar,
    ):
        task = bar.add_task("rounds", total=rounds, values="")
        drawn = draw_in_turns(
            finished_cases(chosen, out), rounds,
            lambda place, number: bar.update(task, completed=number, values=place),
        )  # fmt: skip
    for one in drawn:
        _tell(one)
    uri = default_uri(out)
    if sync_cases(out / chosen.name, uri):
        output.warn("the records are on disk; the next `bench run` or `bench report` logs them")
    return 0


def _tell(drawn: "Drawn") -> None:
    """One case: what a frame took, and between what rounds differed."""
    case, result = drawn.before.case, drawn.result
    before, least, most = drawn.before.result.render_ms, min(drawn.rounds), max(drawn.rounds)
    line = {
        **case_of(result),
        "render_ms": result.render_ms,
        "before": before,
        "rounds": drawn.rounds,
    }
    spread = f"{least:.2f} to {most:.2f} in {len(drawn.rounds)} rounds; it was {before:.2f}"
    output.emit(line, f"{result.render_ms:8.2f} ms  {case.label}  ({spread})")
