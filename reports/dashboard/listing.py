"""Which finished runs a store has: names alone, since reading ten thousand whole runs takes minutes."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from splatproof.base.errors import MissingError
from splatproof.reports.mlflow_client import open_client, shown_uri, sqlite_file
from splatproof.reports.mlflow_search import EXPERIMENTS, STATE
from splatproof.reports.store import complete_runs

QUERY = """
SELECT runs.run_uuid, runs.artifact_uri, runs.end_time, runs.start_time
FROM runs
JOIN experiments ON experiments.experiment_id = runs.experiment_id
JOIN tags ON tags.run_uuid = runs.run_uuid
WHERE runs.lifecycle_stage = 'active' AND experiments.lifecycle_stage = 'active'
  AND experiments.name LIKE ? AND tags.key = ? AND tags.value = 'complete'
"""
"""What MLflow's own search gives for these tags, of its tables as they have been since MLflow 1."""


@dataclass(frozen=True, kw_only=True, order=True)
class Listed:
    """A finished run of the store."""

    ended: int
    """When it ended, in milliseconds since 1970 (UTC)."""
    began: int
    """When it began: decides where two ended at once."""
    run: str
    """MLflow's name of it."""
    files: str
    """Where its files are, as MLflow tells it."""


def list_runs(uri: str) -> list[Listed]:
    """Every run that is complete in the store, from the oldest to the newest.

    An SQLite store is asked by one query: through MLflow each run would come with all its params,
    metrics and tags, which takes minutes for ten thousand runs.

    Args:
        uri: Tracking URI. Nothing is written to the store.
    Returns: Empty where the store's file does not exist.
    Raises: MissingError where the store does not answer or has none of MLflow's tables.
    """
    file = sqlite_file(uri)
    if file is None:
        runs = complete_runs(open_client(uri))
        rows = [
            (r.info.run_id, r.info.artifact_uri, r.info.end_time, r.info.start_time) for r in runs
        ]
    elif not file.exists():
        return []
    else:
        with _read_only(file, uri) as connection:
            rows = connection.execute(QUERY, (f"{EXPERIMENTS}%", STATE)).fetchall()
    return sorted(
        Listed(ended=end or 0, began=start or 0, run=run, files=at or "")
        for run, at, end, start in rows
    )


@contextmanager
def _read_only(file: Path, uri: str) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as connection:
            yield connection
    except sqlite3.Error as error:
        raise MissingError(
            f"tracking store {shown_uri(uri)}: cannot be read: {error}; expected a database that "
            "MLflow 3 wrote, such as `bench report` leaves in its OUT"
        ) from error
