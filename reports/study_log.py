"""The rows of a study into MLflow: one run a study, one metric a row and number."""

import math
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splatproof.base.errors import MissingError
from splatproof.reports.mlflow_client import artifact_root, one_line, open_client, store_errors
from splatproof.reports.mlflow_search import EXPERIMENTS
from splatproof.reports.store import METRICS_A_BATCH

NAMED_BY = ("component", "twin", "case")
"""Columns that name a row."""


def metric_name(row: Mapping[str, Any], column: str) -> str:
    """Name that MLflow takes: other characters than letters, digits and _-./ become a dash.

    Args:
        row: A row of the study; the columns NAMED_BY begin the name.
        column: Column of the row that is logged.
    """
    parts = [str(row[name]) for name in NAMED_BY if row.get(name)]
    return re.sub(r"[^\w\-./ ]+", "-", "/".join([*parts, column]))


def log_study(
    name: str,
    machine: Mapping[str, str],
    rows: Sequence[Mapping[str, Any]],
    files: Sequence[Path],
    uri: str,
) -> str:
    """Log one run in experiment splatproof/<name>: machine as params, numbers as metrics, files.

    Args:
        name: Name of the study.
        machine: What is known of the machine; empty values are left out.
        rows: What the study found; numbers that are not finite are left out.
        files: Files that are kept with the run.
        uri: Tracking URI.
    Returns: One line saying why it is not in the store; empty when it is.
    Raises: UsageError for a URI that cannot work.
    """
    try:
        client = open_client(uri)
    except MissingError as error:
        return str(error)
    from mlflow.entities import Metric, Param

    now = int(1000 * time.time())
    metrics = [
        Metric(metric_name(row, column), float(value), now, 0)
        for row in rows
        for column, value in row.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    ]
    try:
        title = EXPERIMENTS + name
        found = client.get_experiment_by_name(title)
        experiment = (
            found.experiment_id if found else client.create_experiment(title, artifact_root(uri))
        )
        run = client.create_run(experiment, run_name=name, tags={"splatproof.study": name})
        identity = run.info.run_id
        client.log_batch(identity, params=[Param(k, v) for k, v in machine.items() if v])
        for start in range(0, len(metrics), METRICS_A_BATCH):
            client.log_batch(identity, metrics=metrics[start : start + METRICS_A_BATCH])
        for path in files:
            client.log_artifact(identity, str(path))
        client.set_terminated(identity)
    except store_errors() as error:
        return f"tracking store: {one_line(error)}"
    return ""
