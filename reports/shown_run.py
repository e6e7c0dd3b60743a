"""What MLflow's own pages show of a case: its name, description, source, version and data set."""

import functools
import getpass
import json
import math
from typing import TYPE_CHECKING

from splatproof.reference.types.result import Result
from splatproof.reports.repeating import command
from splatproof.reports.run_data import digest

if TYPE_CHECKING:
    from mlflow.entities import DatasetInput

NOTE, PARENT = "mlflow.note.content", "mlflow.parentRunId"
"""Tags that MLflow shows as the description, and as what a run lies under."""


def run_name(result: Result) -> str:
    """Row, seed, scene and protocol: MLflow's pages cut names short, and show the scene beside them."""
    return f"{result.row} seed{result.seed} {result.scene} {result.protocol}"


def shown_tags(result: Result) -> dict[str, str]:
    """MLflow's own tags of a run: source, version, user and description.

    Args:
        result: The case.
    """
    return source_tags(command(result), result.environment.get("commit", "")) | {
        NOTE: description(result)
    }


def source_tags(said: str, commit: str) -> dict[str, str]:
    """Tags for the columns Source, Version and User.

    Args:
        said: The command that made the run.
        commit: Commit of the code, with or without "-dirty"; "" where it is not known.
    """
    source = " ".join(said.split()[:3])
    named = {
        "mlflow.source.type": "LOCAL",
        "mlflow.source.name": source,
        "mlflow.source.git.commit": commit.removesuffix("-dirty"),
        "mlflow.user": _user(),
    }
    return {name: value for name, value in named.items() if value}


def description(result: Result) -> str:
    """Markdown of a run: what the case is, what came out, and how it is repeated."""
    head = (
        f"**{result.row}** on scene **{result.scene}** under protocol `{result.protocol}`, "
        f"seed {result.seed}, of suite `{result.suite}`."
    )
    outcome = f"Failed: {result.error}" if result.error else _scores(result.metrics)
    at = result.environment.get("commit")
    repeat = f"Repeat it{f' at commit `{at}`' if at else ''}:\n\n```\n{command(result)}\n```"
    where = "Renders, truth and error maps are among the artifacts; record.json has every number."
    return f"{head}\n\n{outcome}\n\n{repeat}\n\n{where}"


def data_set(result: Result) -> "DatasetInput":
    """The scene as MLflow's column Dataset shows it, told apart by its files and its split.

    Args:
        result: The case.
    Returns: Name, hash of files and split, and the protocol as what it was used for.
    """
    from mlflow.entities import Dataset, DatasetInput, InputTag

    files = {name: value for name, value in result.scene_facts.items() if name.endswith("sha256")}
    facts = {"test_images": len(result.images), "split_sha256": result.split_sha256, **files}
    return DatasetInput(
        Dataset(
            name=result.scene, digest=digest((files, result.split_sha256))[:8],
            source_type="splatproof", source=json.dumps({"scene": result.scene}),
            profile=json.dumps(facts),
        ),
        [InputTag("mlflow.data.context", result.protocol)],
    )  # fmt: skip


def _scores(metrics: dict[str, float]) -> str:
    finite = {name: value for name, value in metrics.items() if math.isfinite(value)}
    rows = [f"| {name} | {value:.4f} |" for name, value in finite.items()]
    return "\n".join(["| metric | value |", "|---|---|", *rows])


@functools.cache
def _user() -> str:
    """Who logs; "" where the system has no name for them, as in some containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""
