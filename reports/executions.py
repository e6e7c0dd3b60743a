"""The run that the cases of one execution of a suite lie under: one folder of runs at one commit."""

import math
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from splatproof.base.locks import locked_folder
from splatproof.reference.types.result import Result
from splatproof.reports import run_data
from splatproof.reports.mlflow_client import write_tag
from splatproof.reports.mlflow_search import EXECUTION, STATE, search_runs
from splatproof.reports.shown_run import NOTE, source_tags

if TYPE_CHECKING:
    from mlflow.entities import Run
    from mlflow.tracking import MlflowClient

SUITE = "suite"
"""State of such a run, which is no case's: readers of results look for complete ones."""


@dataclass(frozen=True)
class Execution:
    """Cases of one suite that lie in one folder and were made by one commit."""

    suite: str
    commit: str
    """"" where it is not known."""
    root: Path
    """Folder OUT/SUITE that the cases lie in."""

    @property
    def key(self) -> str:
        """What tells it from every other in the store."""
        return f"{socket.gethostname()}:{self.root}@{self.commit}"


def execution_of(folder: Path, result: Result) -> Execution | None:
    """The execution that a case is from; None for a case that no suite ran, such as a fit.

    Args:
        folder: The case's own folder.
        result: The case.
    """
    label, path = run_data.case_name(result), folder.resolve()
    if not path.as_posix().endswith(f"/{label}"):
        return None
    root = path.parents[label.count("/") - 1]
    return Execution(result.suite, result.environment.get("commit", ""), root)


def begin(client: "MlflowClient", execution: Execution, experiment: str, start: int) -> str:
    """The run that cases of this execution are to lie under; it counts as running until `finish`.

    Processes that sync the folder at the same time get the same one.

    Args:
        client: Client of the store.
        execution: Whose run it is.
        experiment: MLflow's identity of the suite's experiment.
        start: When its first case began, in ms since 1970.
    Returns: MLflow's identity of the run.
    """
    with locked_folder(execution.root):
        found = _run_of(client, execution)
        if found is not None:
            client.update_run(found.info.run_id, status="RUNNING")
            return found.info.run_id
        run = client.create_run(
            experiment, start_time=start, run_name=_name(execution),
            tags=source_tags(f"bench run {execution.suite}", execution.commit)
            | {STATE: SUITE, EXECUTION: execution.key},
        )  # fmt: skip
        return run.info.run_id


def unfinished(client: "MlflowClient") -> dict[str, str]:
    """Executions that some process began to log and did not finish: key to identity of the run."""
    runs = search_runs(client, f"tags.`{STATE}` = '{SUITE}' AND attributes.status = 'RUNNING'")
    return {run.data.tags[EXECUTION]: run.info.run_id for run in runs}


def finish(
    client: "MlflowClient", run: str, execution: Execution, results: Sequence[Result], end: int
) -> None:
    """Write what came out below the run, and end it.

    Args:
        client: Client of the store.
        run: MLflow's identity of the run.
        execution: Whose run it is.
        results: All its cases.
        end: When its last case ended, in ms since 1970.
    """
    write_tag(partial(client.set_tag, run), NOTE, description(execution, results))
    failed = any(result.error for result in results)
    client.set_terminated(run, "FAILED" if failed else "FINISHED", end)


def description(execution: Execution, results: Sequence[Result]) -> str:
    """Markdown of an execution: the means of each row over its seeds, and how it is repeated.

    Args:
        execution: Whose it is.
        results: All its cases.
    """
    at = f" at commit `{execution.commit}`" if execution.commit else ""
    failed = [result for result in results if result.error]
    count = f"{len(results)} cases" + (f", {len(failed)} failed" if failed else "")
    head = f"Suite **{execution.suite}**{at}: {count}, from `{execution.root}`."
    lines = [head, _table([result for result in results if not result.error])]
    lines += [f"Failed: {run_data.case_name(case)}: {case.error}" for case in failed]
    return "\n\n".join([*lines, f"Repeat it:\n\n```\nbench run {execution.suite}\n```"])


def _table(results: Sequence[Result]) -> str:
    """Means over the seeds of each scene, row and protocol."""
    names = list(dict.fromkeys(name for result in results for name in result.metrics))
    groups: dict[tuple[str, str, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.scene, result.protocol, result.row), []).append(result)
    head = ["scene", "protocol", "row", "seeds", *names]
    lines = [_line(head), "|".join(["", *["---"] * len(head), ""])]
    for (scene, protocol, row), own in sorted(groups.items()):
        means = [np.mean([one.metrics.get(name, math.nan) for one in own]) for name in names]
        shown = ["" if math.isnan(mean) else f"{mean:.4f}" for mean in means]
        lines.append(_line([scene, protocol, row, str(len(own)), *shown]))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '-') for cell in cells)} |"


def _name(execution: Execution) -> str:
    return f"{execution.suite} {execution.commit[:7]}".strip()


def _run_of(client: "MlflowClient", execution: Execution) -> "Run | None":
    """The execution's own run; the key may hold quotes, which MLflow's conditions cannot."""
    runs = search_runs(client, f"tags.`{STATE}` = '{SUITE}'")
    return next((run for run in runs if run.data.tags.get(EXECUTION) == execution.key), None)
