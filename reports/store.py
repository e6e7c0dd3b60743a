"""Finished cases into MLflow, and results back out of MLflow alone."""

import hashlib
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
from splatproof.base.locks import lock
from splatproof.reference.types.result import Result, picture_name
from splatproof.reference.types.result_json import result_from_json
from splatproof.reports import run_data
from splatproof.reports.mlflow_client import (
    artifact_root,
    check_uri,
    one_line,
    open_client,
    shown_uri,
    sqlite_file,
    store_errors,
)

if TYPE_CHECKING:
    from mlflow.entities import Run
    from mlflow.store.artifact.artifact_repo import ArtifactRepository
    from mlflow.tracking import MlflowClient

EXPERIMENTS = "splatproof/"
"""Start of the name of every experiment of ours; the suite's name follows."""
ARTIFACTS = ("record.json", "renders", "truth", "masks", "errors", "seams", "blocks", "model")
"""What of a case folder is logged. Checkpoints are not: they are of no use once a case is done."""
STATE, RECORD, ORIGIN, CASE = (
    f"splatproof.{name}" for name in ("state", "record_sha256", "origin", "case")
)
"""Tags: logging or complete; hash of record.json; host and folder it came from; `case_key`."""
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


def find_cases(out: Path) -> list[Path]:
    """Every case folder below `out` that holds a record, sorted."""
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
        client = open_client(uri)
        while waiting:
            on_progress(total - len(waiting), total)
            folder = waiting.pop(0)
            try:
                with _locked(folder / "record.json") as record:
                    _sync_case(client, folder, record, uri)
            except (DataError, *store_errors()) as error:
                failures.append(Failure(folder, one_line(error)))
                open_client(uri)  # a store that is gone ends the loop here
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
    return _runs(client, f"tags.`{STATE}` = 'complete'")


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
    return file.read_bytes() if file.is_relative_to(root) and file.is_file() else None


@contextmanager
def _locked(record: Path) -> Iterator[bytes]:
    """The record's bytes, held so that no other process logs this case meanwhile."""
    try:
        file = record.open("rb")
    except FileNotFoundError as error:
        raise DataError(f"{record}: no such record; run the case first") from error
    with file:
        lock(file)
        yield file.read()


def _sync_case(client: "MlflowClient", folder: Path, record: bytes, uri: str) -> None:
    """Log one case unless this very record is complete in the store."""
    try:
        result = result_from_json(record.decode(), str(folder / "record.json"))
    except UnicodeDecodeError as error:
        raise DataError(f"{folder / 'record.json'}: not UTF-8 text: {error}") from error
    sha, origin = hashlib.sha256(record).hexdigest(), f"{socket.gethostname()}:{folder.resolve()}"
    if _runs(client, f"tags.`{RECORD}` = '{sha}' AND tags.`{STATE}` = 'complete'"):
        return
    for run in _runs(client, f"tags.`{STATE}` = 'logging'"):
        if run.data.tags[ORIGIN] == origin:
            _delete(client, run, uri)
    ends = int((folder / "record.json").stat().st_mtime * 1000)
    marks = {STATE: "logging", RECORD: sha, ORIGIN: origin, CASE: run_data.case_key(result)}
    run = client.create_run(
        _experiment(client, EXPERIMENTS + result.suite, artifact_root(uri)),
        start_time=ends - int(1000 * sum(result.stages.values())),
        tags={**run_data.tags(result), **marks},
        run_name=run_data.case_name(result),
    )
    _log(client, run, folder, result)
    client.set_terminated(run.info.run_id, "FAILED" if result.error else "FINISHED", ends)
    client.set_tag(run.info.run_id, STATE, "complete")


def _log(client: "MlflowClient", run: "Run", folder: Path, result: Result) -> None:
    """Send params, metrics, curves and files, in batches of the size that MLflow takes."""
    from mlflow.entities import Metric, Param

    identity, when = run.info.run_id, run.info.start_time
    values = [Metric(name, value, when, 0) for name, value in run_data.metrics(result).items()]
    values += [Metric(name, value, when, step) for name, step, value in run_data.curves(result)]
    for batch in _batches(values, METRICS_A_BATCH):
        client.log_batch(identity, metrics=batch)
    named = run_data.params(result).items()
    for batch in _batches([Param(n, v[:LONGEST_PARAM]) for n, v in named], PARAMS_A_BATCH):
        client.log_batch(identity, params=batch)
    for name in ARTIFACTS:
        path = folder / name
        if path.is_dir():
            client.log_artifacts(identity, str(path), name)
        elif path.exists():
            client.log_artifact(identity, str(path))


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _experiment(client: "MlflowClient", name: str, location: str | None) -> str:
    """Identity of the experiment, made where it does not exist."""
    found = client.get_experiment_by_name(name)
    return found.experiment_id if found else client.create_experiment(name, location)


def _runs(client: "MlflowClient", filter_string: str) -> list["Run"]:
    """All our runs that match, page by page."""
    ours = f"name LIKE '{EXPERIMENTS}%'"
    experiments = [e.experiment_id for e in _pages(client.search_experiments, filter_string=ours)]
    if not experiments:
        return []
    return _pages(client.search_runs, experiment_ids=experiments, filter_string=filter_string)


def _pages(search: Callable[..., Any], **query: object) -> list[Any]:
    items, token = [], None
    while True:
        page = search(**query, page_token=token)
        items += page
        token = page.token
        if not token:
            return items


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
