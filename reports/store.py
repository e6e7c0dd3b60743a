"""Finished cases into MLflow, and results back out of MLflow alone."""

import hashlib
import itertools
import os
import socket
import tempfile
import urllib.parse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from splatproof.base.errors import DataError, MissingError
from splatproof.base.files import read_bytes, read_text, size_of
from splatproof.base.locks import lock
from splatproof.reference.types.result import Result, picture_name
from splatproof.reference.types.result_json import result_from_json
from splatproof.reports import executions, run_data
from splatproof.reports.executions import Execution, execution_of
from splatproof.reports.mlflow_client import (
    artifact_root,
    check_uri,
    one_line,
    open_client,
    shown_uri,
    sqlite_file,
    store_errors,
)
from splatproof.reports.mlflow_search import (
    CASE,
    ORIGIN,
    RECORD,
    STATE,
    experiment_of,
    search_runs,
)
from splatproof.reports.saved_views import Shown, write_views
from splatproof.reports.shown_run import PARENT, data_set, run_name, shown_tags

if TYPE_CHECKING:
    from mlflow.entities import Experiment, Run
    from mlflow.store.artifact.artifact_repo import ArtifactRepository
    from mlflow.tracking import MlflowClient

ARTIFACTS = ("record.json", "renders", "truth", "masks", "errors", "seams", "blocks", "model")
"""What of a case folder is logged. Checkpoints are not: they are of no use once a case is done."""
FOLDERS = {"render": "renders", "truth": "truth", "error": "errors"}
Picture = Literal["render", "truth", "error"]
# metrics and params that MLflow takes in one batch
METRICS_A_BATCH, PARAMS_A_BATCH, LONGEST_PARAM = 1000, 100, 6000


@dataclass(frozen=True)
class Failure:
    """A case that is not in the store, and one line saying why."""

    folder: Path
    reason: str


@dataclass(frozen=True)
class StoredResult:
    """A result that was read from MLflow, and the way to its pictures."""

    result: Result
    uri: str
    artifact_uri: str
    """Where the run's files are, as MLflow tells it."""

    def picture(self, kind: Picture, image: str) -> bytes | None:
        """The PNG of a test image as it was logged.

        Args:
            kind: Its render, its truth or its error map.
            image: Name of the view, as in ImageScore.name.
        Returns: The file's bytes; None where the case has no such picture.
        """
        path = f"{FOLDERS[kind]}/{picture_name(image)}"
        return read_file(self.artifact_uri, self.uri, path)


def find_cases(out: str | Path) -> list[Path]:
    """Every case folder below `out` that holds a record, sorted."""
    out = Path(out)
    if not out.is_dir():
        return []
    found = []
    for folder, below, files in os.walk(out):
        if "record.json" in files:
            found.append(Path(folder))
            below.clear()
        # neither the store's own copies nor what a later run has replaced
        below[:] = [name for name in below if name != "mlartifacts" and name[0] != "."]
    return sorted(found)


def sync(
    case_folders: Iterable[Path],
    uri: str,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Failure]:
    """Log the finished cases that the store does not hold yet; what it holds is left alone.

    A run that a killed process left half-logged is deleted and logged again. A case whose record
    has changed is logged beside the old one; readers take the newer. Two processes may sync the
    same folder at once. Once the store stops answering, the other cases are not tried.

    Args:
        case_folders: Folders with a record.json (see `find_cases`).
        uri: Tracking URI.
        on_progress: Called with (cases done, cases in all).
    Returns: The cases that are not in the store; empty when all are.
    Raises: UsageError for a URI that cannot work.
    """
    waiting, failures = list(case_folders), []
    total = len(waiting)
    check_uri(uri)
    if not waiting:
        return []  # and make no store
    try:
        log = _Sync(open_client(uri), uri)
        while waiting:
            on_progress(total - len(waiting), total)
            folder = waiting.pop(0)
            try:
                with _locked(folder / "record.json") as record:
                    log.case(folder, record)
            except (DataError, *store_errors()) as error:
                failures.append(Failure(folder, one_line(error)))
                open_client(uri)  # a store that is gone ends the loop here
        failures += log.end()
        on_progress(total, total)
    except MissingError as error:
        failures += [Failure(folder, str(error)) for folder in waiting]
    return failures


def read_results(uri: str) -> list[StoredResult]:
    """The newest result of every case in the store, sorted by case and settings.

    Args:
        uri: Tracking URI. Nothing but this store is read.
    Raises:
        MissingError: The store does not answer, or the files of a run are gone.
        DataError: A record in the store is damaged.
    """
    newest = {
        (run_data.case_name(one.result), run_data.case_key(one.result)): one
        for one in read_history(uri)
    }
    return [newest[case] for case in sorted(newest)]


def read_history(uri: str) -> list[StoredResult]:
    """Every result in the store, from the one that ended first to the one that ended last.

    Args:
        uri: Tracking URI. Nothing but this store is read.
    Raises: As `read_results`.
    """
    check_uri(uri)
    file = sqlite_file(uri)
    if file is not None and not file.exists():
        return []
    client = open_client(uri)
    found: list[tuple[int, StoredResult]] = []
    for run in complete_runs(client):
        files = run.info.artifact_uri or ""
        result = read_run(uri, run.info.run_id, files)
        found.append((run.info.end_time or 0, StoredResult(result, uri, files)))
    found.reverse()  # the store gives what began last first, which decides where two ended at once
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]


def complete_runs(client: "MlflowClient") -> list["Run"]:
    """Every run of ours that was logged to its end: all runs of a case, not its newest alone."""
    return search_runs(client, f"tags.`{STATE}` = 'complete'")


def read_run(uri: str, run: str, files: str) -> Result:
    """The record of one run.

    Args:
        uri: Tracking URI.
        run: MLflow's name of the run, for errors.
        files: Where its files are, as MLflow tells it.
    Raises:
        MissingError: They are not there.
        DataError: The record is damaged.
    """
    text = read_file(files, uri, "record.json")
    if text is None:
        raise MissingError(
            f"tracking store {shown_uri(uri)}: the files of run {run} are not at {files}; if the "
            "folder was moved, delete its mlflow.db and run `bench report` again"
        )
    return result_from_json(text.decode(), f"{shown_uri(uri)} run {run}")


def read_file(files: str, uri: str, path: str) -> bytes | None:
    """The bytes of a logged file; None where there is none of that name.

    Files on this machine are read where they lie: MLflow would copy each of them first.

    Args:
        files: Where the run's files are, as MLflow tells it.
        uri: Tracking URI.
        path: The file's path below them; one that leads out of them names no file.
    """
    parts = urllib.parse.urlsplit(files)
    if parts.scheme not in ("", "file"):
        return _artifact(files, uri, path)
    root = Path(urllib.parse.unquote(parts.path)).resolve()
    file = (root / path).resolve()
    return read_bytes(file) if file.is_relative_to(root) and file.is_file() else None


@contextmanager
def _locked(record: Path) -> Iterator[bytes]:
    """The record's bytes, held so that no other process logs this case meanwhile."""
    size_of(record)
    with record.open("rb") as file:
        lock(file)
        yield file.read()


class _Sync:
    """One pass over case folders: the cases one by one, then what is said of all of them."""

    def __init__(self, client: "MlflowClient", uri: str) -> None:
        self._client, self._uri = client, uri
        self._experiments: dict[str, Experiment] = {}
        self._shown: dict[str, Shown] = {}
        self._executions: dict[str, Execution] = {}
        self._begun: dict[str, str] = {}
        self._last: list[Path] = []

    def case(self, folder: Path, record: bytes) -> None:
        """Log one case unless this very record is complete in the store."""
        try:
            result = result_from_json(record.decode(), str(folder / "record.json"))
        except UnicodeDecodeError as error:
            raise DataError(f"{folder / 'record.json'}: not UTF-8 text: {error}") from error
        self._shown.setdefault(result.suite, Shown()).add(result)
        self._last = [folder]
        execution = execution_of(folder, result)
        if execution is not None:
            self._executions[execution.key] = execution
        client, sha = self._client, hashlib.sha256(record).hexdigest()
        origin = f"{socket.gethostname()}:{folder.resolve()}"
        experiment = self._experiment(result.suite).experiment_id
        here = [experiment]
        known = f"tags.`{RECORD}` = '{sha}' AND tags.`{STATE}` = 'complete'"
        if search_runs(client, known, here):
            return
        for run in search_runs(client, f"tags.`{STATE}` = 'logging'", here):
            if run.data.tags[ORIGIN] == origin:
                _delete(client, run, self._uri)
        ends = _end(folder / "record.json")
        marks = {STATE: "logging", RECORD: sha, ORIGIN: origin, CASE: run_data.case_key(result)}
        if execution is not None:
            marks[PARENT] = self._parent(execution)
        run = client.create_run(
            experiment, start_time=_start(result, ends),
            tags={**run_data.tags(result), **shown_tags(result), **marks},
            run_name=run_name(result),
        )  # fmt: skip
        _log(client, run, folder, result)
        client.set_terminated(run.info.run_id, "FAILED" if result.error else "FINISHED", ends)
        client.set_tag(run.info.run_id, STATE, "complete")

    def end(self) -> list[Failure]:
        """Finish the executions that were begun, here or by a process that was killed."""
        try:
            self._ended()
        except store_errors() as error:
            # cases that no suite ran, such as fits, have no execution to name
            roots = [one.root for one in self._executions.values()] or self._last
            return [Failure(root, one_line(error)) for root in roots]
        return []

    def _ended(self) -> None:
        for suite, shown in self._shown.items():
            write_views(self._client, self._experiment(suite), suite, shown)
        for key, run in executions.unfinished(self._client).items():
            if key in self._executions:
                self._finish(run, self._executions[key])

    def _finish(self, run: str, execution: Execution) -> None:
        """Say what came out of all cases of an execution, also of those that were not asked for."""
        cases = _cases_of(execution)
        ends = max(end for _, end in cases)
        executions.finish(self._client, run, execution, [result for result, _ in cases], ends)

    def _experiment(self, suite: str) -> "Experiment":
        if suite not in self._experiments:
            found = experiment_of(self._client, suite, artifact_root(self._uri))
            self._experiments[suite] = found
        return self._experiments[suite]

    def _parent(self, execution: Execution) -> str:
        if execution.key not in self._begun:
            experiment = self._experiment(execution.suite).experiment_id
            start = min(_start(result, end) for result, end in _cases_of(execution))
            run = executions.begin(self._client, execution, experiment, start)
            self._begun[execution.key] = run
        return self._begun[execution.key]


def _cases_of(execution: Execution) -> list[tuple[Result, int]]:
    """Every case of an execution, and when it ended in ms since 1970; damaged records are none."""
    found = []
    for folder in find_cases(execution.root):
        record = folder / "record.json"
        try:
            result = result_from_json(read_text(record), str(record))
        except DataError:
            continue  # told where it is synced
        if execution_of(folder, result) == execution:
            found.append((result, _end(record)))
    return found


def _end(record: Path) -> int:
    return int(record.stat().st_mtime * 1000)


def _start(result: Result, end: int) -> int:
    return end - int(1000 * sum(result.stages.values()))


def _log(client: "MlflowClient", run: "Run", folder: Path, result: Result) -> None:
    """Send params, metrics, curves, the data set and files, in batches that MLflow takes."""
    from mlflow.entities import Metric, Param

    identity, when = run.info.run_id, run.info.start_time
    values = [Metric(name, value, when, 0) for name, value in run_data.metrics(result).items()]
    # with a time of their own, MLflow draws curves over seconds too
    values += [
        Metric(name, value, when + int(1000 * seconds), step)
        for name, step, value, seconds in run_data.curves(result)
    ]
    named = [Param(n, v[:LONGEST_PARAM]) for n, v in run_data.params(result).items()]
    batches = itertools.zip_longest(
        _batches(values, METRICS_A_BATCH), _batches(named, PARAMS_A_BATCH), fillvalue=()
    )
    for some_metrics, some_params in batches:
        client.log_batch(identity, metrics=some_metrics, params=some_params)
    client.log_inputs(identity, datasets=[data_set(result)])
    for name in ARTIFACTS:
        path = folder / name
        if path.is_dir():
            client.log_artifacts(identity, str(path), name)
        elif path.exists():
            client.log_artifact(identity, str(path))


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _delete(client: "MlflowClient", run: "Run", uri: str) -> None:
    """Remove a half-logged run and its files."""
    _repository(run.info.artifact_uri or "", uri).delete_artifacts()
    client.delete_run(run.info.run_id)


def _artifact(artifact_uri: str, uri: str, path: str) -> bytes | None:
    """The bytes of a logged file; None where there is none of that name."""
    repository = _repository(artifact_uri, uri)
    with tempfile.TemporaryDirectory() as folder:
        try:
            return Path(repository.download_artifacts(path, folder)).read_bytes()
        except store_errors():
            folder_of = path.rpartition("/")[0] or None
            if any(file.path == path for file in repository.list_artifacts(folder_of)):
                raise  # it is there and did not arrive
            return None


def _repository(artifact_uri: str, uri: str) -> "ArtifactRepository":
    from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

    return get_artifact_repository(artifact_uri, tracking_uri=uri)
