"""MLflow: idempotent logging, killed processes, absent servers, and reading it all back."""

import dataclasses
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mlflow.exceptions import MlflowException
from mlflow.tracking import MlflowClient
from sqlalchemy import Connection, Engine, event

from helpers import case_folders
from helpers.forked import ended, forked
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.reference.types.result_json import result_to_json
from splatproof.reports import run_data, store
from splatproof.reports.executions import SUITE
from splatproof.reports.mlflow_client import (
    check_uri,
    default_uri,
    open_client,
    shown_uri,
    sqlite_file,
    sqlite_uri,
)
from splatproof.reports.mlflow_search import EXPERIMENTS, STATE
from splatproof.reports.shown_run import NOTE
from splatproof.reports.store import Failure, Picture, find_cases, read_results, sync

KINDS: tuple[Picture, ...] = ("truth", "render", "error")
REFUSING = "http://127.0.0.1:9"  # the discard port: nothing listens there


@pytest.fixture
def uri(migrated: Path, tmp_path: Path) -> str:
    shutil.copy(migrated, tmp_path / "mlflow.db")
    return f"sqlite:///{tmp_path / 'mlflow.db'}"


def runs_of(uri: str, *, parents: bool = False) -> list:
    """Every run of the suite's cases, or of its executions, that is not deleted."""
    client = open_client(uri)
    experiment = client.get_experiment_by_name(EXPERIMENTS + "quick")
    runs = client.search_runs([experiment.experiment_id]) if experiment else []
    return [run for run in runs if (run.data.tags[STATE] == SUITE) == parents]


def write(out: Path, seed: int = 0, **changes: Any) -> Path:
    case = dataclasses.replace(case_folders.result(seed=seed), **changes)
    return case_folders.write_case(out, case)


def test_results_and_pictures_come_back_from_the_store_alone(tmp_path: Path, uri: str):
    odd = {"psnr": math.inf, "ssim_3dgs": math.nan, "mse": 0.0}
    folders = [write(tmp_path, seed=0), write(tmp_path, seed=1, metrics=odd)]
    files = ("truth", "renders", "errors")
    pictures = {
        kind: (folders[0] / name / "dji_0001.png").read_bytes()
        for kind, name in zip(KINDS, files, strict=True)
    }
    assert sync(folders, uri) == []
    shutil.rmtree(tmp_path / "quick")
    stored = read_results(uri)
    wanted = [
        case_folders.result(seed=0),
        dataclasses.replace(case_folders.result(seed=1), metrics=odd),
    ]
    assert [result_to_json(one.result) for one in stored] == list(map(result_to_json, wanted))
    assert {kind: stored[0].picture(kind, "dji_0001.jpg") for kind in KINDS} == pictures
    assert stored[0].picture("render", "no_such.jpg") is None


def test_what_mlflow_itself_shows(tmp_path: Path, uri: str):
    folder = write(tmp_path, error="")
    sync([folder], uri)
    (run,) = runs_of(uri)
    case = case_folders.result()
    assert run.info.run_name == "3dgs seed0 town ours_250"
    assert run.info.status == "FINISHED"
    assert run.data.metrics["psnr"] == case.metrics["psnr"]
    assert run.data.metrics["seconds/train"] == case.stages["train"]
    assert run.data.metrics["cost/primitives"] == case.primitives
    assert run.data.params["settings.densify.grad_threshold"] == "0.0002"
    assert run.data.params["protocol_rules.rounding"] == "round"
    assert run.data.tags["environment.torch"] == "2.13.0"
    client = open_client(uri)
    loss = client.get_metric_history(run.info.run_id, "curve/loss")
    assert [(m.step, m.value) for m in loss] == [(s, v["loss"]) for s, v in case.curve]
    seconds = [(m.timestamp - run.info.start_time) / 1000 for m in loss]
    assert seconds == pytest.approx(case.curve_seconds, abs=0.01)
    listed = {file.path for file in client.list_artifacts(run.info.run_id)}
    assert listed == {"record.json", "renders", "truth", "errors", "model"}


def test_more_values_than_one_batch_takes(tmp_path: Path, uri: str):
    curve = tuple((step, {"loss": 1 / (step + 1)}) for step in range(1500))
    settings = {f"s{i}": "x" * 7000 for i in range(150)}
    sync([write(tmp_path, curve=curve, settings=settings)], uri)
    (run,) = runs_of(uri)
    assert len(open_client(uri).get_metric_history(run.info.run_id, "curve/loss")) == 1500
    assert len([name for name in run.data.params if name.startswith("settings.")]) == 150
    assert read_results(uri)[0].result.settings == settings


def test_a_second_sync_logs_nothing(tmp_path: Path, uri: str):
    folders = [write(tmp_path, seed) for seed in range(3)]
    assert sync(folders[:2], uri) == []
    before = {run.info.run_id for run in runs_of(uri)}
    assert sync(folders, uri) == []
    assert sync(folders, uri) == []
    after = {run.info.run_id for run in runs_of(uri)}
    assert before < after
    assert len(after) == 3


def test_the_newer_record_of_a_case_is_read(tmp_path: Path, uri: str):
    old = write(tmp_path, primitives=1)
    os.utime(old / "record.json", (1_700_000_000, 1_700_000_000))
    sync([old], uri)
    sync([write(tmp_path, primitives=2)], uri)
    assert [one.result.primitives for one in read_results(uri)] == [2]
    assert len(runs_of(uri)) == 2  # history stays


def test_other_settings_are_another_case(tmp_path: Path, uri: str):
    sync([write(tmp_path)], uri)
    sync([write(tmp_path, settings={"iterations": 9})], uri)
    assert len(read_results(uri)) == 2


def dies_at(moment: str, folder: Path, uri: str) -> int:
    """Log a case in a process that is killed where it first calls a method of MLflow's client."""

    def die(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def work() -> None:
        setattr(MlflowClient, moment, die)
        sync([folder], uri)

    return ended(forked(work))


@pytest.mark.parametrize("moment", ["log_batch", "log_artifacts", "set_tag"])
def test_a_case_half_logged_by_a_killed_process_is_replaced(moment: str, tmp_path: Path, uri: str):
    folder = write(tmp_path)
    assert dies_at(moment, folder, uri) == -signal.SIGKILL
    (half,) = runs_of(uri)
    assert half.data.tags[STATE] == "logging"
    assert read_results(uri) == []
    assert sync([folder], uri) == []
    (whole,) = runs_of(uri)
    assert whole.info.run_id != half.info.run_id
    assert not Path(half.info.artifact_uri.removeprefix("file://")).exists()
    assert [one.result.seed for one in read_results(uri)] == [0]


def test_a_case_that_another_process_logs_is_waited_for(tmp_path: Path, uri: str):
    folder = write(tmp_path)

    def work() -> None:
        assert sync([folder], uri) == []

    assert [ended(pid) for pid in [forked(work), forked(work)]] == [0, 0]
    assert len(runs_of(uri)) == 1


def test_a_tag_that_another_process_writes_first_is_written_again(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
):
    """Every tag of the experiment and of the execution collides, each once."""
    folder, written, collisions = write(tmp_path), set[str](), list[str]()

    def colliding(write: Any) -> Any:
        def tag(client: MlflowClient, owner: str, key: str, value: str) -> None:
            if key != STATE and key not in written:
                written.add(key)
                collisions.append(key)
                raise MlflowException("UNIQUE constraint failed: experiment_tags.key")
            write(client, owner, key, value)

        return tag

    for name in ("set_experiment_tag", "set_tag"):
        monkeypatch.setattr(MlflowClient, name, colliding(getattr(MlflowClient, name)))
    assert sync([folder], uri) == []
    assert len(collisions) > 3
    experiment = MlflowClient(uri).get_experiment(runs_of(uri)[0].info.experiment_id)
    assert set(collisions) <= {*experiment.tags, NOTE}


def test_views_that_cannot_be_written_are_told_also_of_a_case_that_no_suite_ran(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
):
    folder = case_folders.fill_folder(tmp_path / "my_fit", case_folders.result())

    def refuses(*arguments: object) -> None:
        raise MlflowException("read-only database")

    monkeypatch.setattr(store, "write_views", refuses)
    (failure,) = sync([folder], uri)
    assert failure == Failure(folder, "read-only database")


def test_an_absent_server_costs_seconds_and_the_records_are_logged_later(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    folders = [write(tmp_path, seed) for seed in range(3)]
    start = time.monotonic()
    failures = sync(folders, REFUSING)
    assert time.monotonic() - start < 5  # one refused connection, not one a case
    assert [one.folder for one in failures] == folders
    assert all("does not answer" in one.reason and "\n" not in one.reason for one in failures)
    with pytest.raises(MissingError, match=r"127\.0\.0\.1:9 does not answer"):
        read_results(REFUSING)
    assert sync([one.folder for one in failures], uri) == []
    assert len(read_results(uri)) == 3


def test_retries_are_bounded_without_the_users_help(monkeypatch: pytest.MonkeyPatch):
    for name in ("MAX_RETRIES", "BACKOFF_FACTOR", "TIMEOUT"):
        monkeypatch.delenv(f"MLFLOW_HTTP_REQUEST_{name}", raising=False)
    start = time.monotonic()
    with pytest.raises(MissingError):
        open_client(REFUSING)
    assert time.monotonic() - start < 10  # waits of 0 and 2 s and their jitter of up to 1 s


def test_a_store_that_dies_midway_ends_the_loop(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
):
    from mlflow.exceptions import MlflowException
    from mlflow.tracking import MlflowClient

    folders = [write(tmp_path, seed) for seed in range(4)]
    honest, calls = MlflowClient.log_artifacts, []

    def failing(*args: Any, **names: Any) -> object:
        calls.append(args)
        if len(calls) > 6:  # four folders of files a case: dies within the second
            monkeypatch.setattr(MlflowClient, "search_experiments", refuse)
            raise MlflowException("connection reset\nsecond line")
        return honest(*args, **names)

    def refuse(*_: object, **__: object) -> object:
        raise MlflowException("connection refused")

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "log_artifacts", failing)
        failures = sync(folders, uri)
    monkeypatch.undo()
    assert [one.folder for one in failures] == folders[1:]
    assert failures[0].reason == "connection reset"
    assert len(calls) == 7  # the third and fourth were not tried
    assert sync(folders, uri) == []
    assert [run.data.tags[STATE] for run in runs_of(uri)] == ["complete"] * 4


def test_damaged_records_fail_alone(tmp_path: Path, uri: str):
    good, damaged, binary = (write(tmp_path, seed) for seed in range(3))
    (damaged / "record.json").write_text("{")
    (binary / "record.json").write_bytes(b"\xff\xfe")
    failures = sync([damaged, binary, tmp_path / "gone", good], uri)
    reasons = [one.reason for one in failures]
    assert [one.folder for one in failures] == [damaged, binary, tmp_path / "gone"]
    assert "not a result record" in reasons[0]
    assert "not UTF-8" in reasons[1]
    assert "no such file" in reasons[2]
    assert all("record.json" in reason for reason in reasons)
    assert len(read_results(uri)) == 1


def test_files_that_were_moved_away_are_named(tmp_path: Path, uri: str):
    sync([write(tmp_path)], uri)
    shutil.rmtree(tmp_path / "mlartifacts")
    with pytest.raises(MissingError, match="delete its mlflow.db and run `bench report` again"):
        read_results(uri)


def test_without_cases_no_store_is_made(tmp_path: Path):
    assert read_results(f"sqlite:///{tmp_path / 'mlflow.db'}") == []
    assert sync([], f"sqlite:///{tmp_path / 'mlflow.db'}") == []
    assert list(tmp_path.iterdir()) == []


def test_cases_are_found_but_not_the_stores_copies(tmp_path: Path, uri: str):
    folders = sorted(write(tmp_path, seed) for seed in range(2))
    (tmp_path / "quick" / "unfinished").mkdir()
    sync(folders, uri)
    assert find_cases(tmp_path) == folders
    assert find_cases(tmp_path / "nowhere") == []


def test_default_uri(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert default_uri(tmp_path) == f"sqlite:///{tmp_path}/mlflow.db"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://example.invalid:5000")
    assert default_uri(tmp_path) == "http://example.invalid:5000"


@pytest.mark.parametrize("name", ["a?b", "a#b", "50%", "a%20b", "a b@c:d"])
def test_a_store_lies_in_the_folder_of_its_runs_whatever_that_is_called(
    migrated: Path, tmp_path: Path, name: str
):
    out, other = tmp_path / name, tmp_path / name[:1]
    for folder in {out, other}:
        folder.mkdir()
        shutil.copy(migrated, folder / "mlflow.db")
    uri = default_uri(out)
    assert sqlite_file(uri) == out / "mlflow.db"
    before = sorted(tmp_path.iterdir())
    case = write(out)
    assert sync([case], uri) == []
    (stored,) = read_results(uri)
    assert stored.picture("render", "dji_0001.jpg") == (case / "renders/dji_0001.png").read_bytes()
    assert sorted(tmp_path.iterdir()) == before  # nothing beside it
    assert read_results(default_uri(other)) == []


def test_a_new_store_lies_in_its_folder_too(tmp_path: Path):
    (tmp_path / "a?b").mkdir()
    open_client(default_uri(tmp_path / "a?b"))
    assert (tmp_path / "a?b" / "mlflow.db").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["a?b"]


def test_a_folder_that_no_uri_can_name(tmp_path: Path):
    with pytest.raises(UsageError, match="not UTF-8, so a tracking URI cannot name it"):
        sqlite_uri(tmp_path / os.fsdecode(b"\xff") / "mlflow.db")


def test_what_is_no_store_is_refused_at_once(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for uri, said in [
        (f"sqlite:///{tmp_path}", "is a folder"),
        (f"sqlite:///{tmp_path}/pipe", "is a pipe"),
        ("http://[::1", "Invalid IPv6 URL; expected http://HOST:PORT"),
    ]:
        for ask in (check_uri, open_client, read_results):
            with pytest.raises(UsageError, match=said):
                ask(uri)


@pytest.mark.parametrize("bad", ["mlruns", "./mlruns", "/a/b", "file:///a/b", "file:mlruns"])
def test_stores_that_mlflow_refuses_are_refused_early(bad: str):
    with pytest.raises(UsageError, match="sqlite:///"):
        check_uri(bad)
    with pytest.raises(UsageError, match="sqlite:///"):
        sync([Path("anything")], bad)


def test_a_store_whose_scheme_is_unknown_is_missing():
    with pytest.raises(MissingError, match="nosuch://x does not answer"):
        open_client("nosuch://x")


def test_passwords_are_not_shown():
    assert shown_uri("https://user:secret@host:5000/p") == "https://host:5000/p"
    assert shown_uri("sqlite:////runs/a@b/mlflow.db") == "sqlite:////runs/a@b/mlflow.db"


@pytest.mark.parametrize(
    "uri",
    ["http://me:s3cret@127.0.0.1:9/x", "nosuch://me:s3cret@x", "http://me:s3cret@[::1",
     "postgresql://me:s3cret@127.0.0.1:9/db", "file://me:s3cret@host/x"],
)  # fmt: skip
def test_no_error_tells_a_password(uri, monkeypatch):
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises((MissingError, UsageError)) as caught:
        open_client(uri)
    assert "s3cret" not in str(caught.value)


def test_the_key_of_a_case_sees_settings_and_rules_but_not_scores():
    case = case_folders.result()
    same = dataclasses.replace(case, metrics={}, settings=dict(reversed(case.settings.items())))
    assert run_data.case_key(same) == run_data.case_key(case)
    others: list[dict[str, Any]] = [
        {"seed": 7}, {"settings": {"iterations": 1}}, {"protocol_rules": {"hold": 3}},
    ]  # fmt: skip
    for change in others:
        assert run_data.case_key(dataclasses.replace(case, **change)) != run_data.case_key(case)


def test_names_that_mlflow_refuses_are_mended():
    case = dataclasses.replace(case_folders.result(), settings={"a(b)": {"c=d": 1}})
    assert run_data.params(case)["settings.a_b_.c_d"] == "1"


def test_no_network_no_warning_and_no_clash_with_the_package_named_datasets(
    tmp_path: Path, uri: str
):
    code = """
        import socket, sys, pathlib
        def refuse(*a, **k): raise SystemExit("a connection was tried: %r" % (a,))
        socket.socket.connect = socket.getaddrinfo = refuse
        from splatproof.reports import store
        assert store.sync([pathlib.Path(sys.argv[1])], sys.argv[2]) == []
        assert len(store.read_results(sys.argv[2])) == 1
    """
    command = [sys.executable, "-W", "error", "-c", textwrap.dedent(code), write(tmp_path), uri]
    done = subprocess.run(
        command,
        check=False,
        cwd=Path(__file__).parents[2],  # where `import datasets` finds our folder
        env={name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """A real `mlflow server` on a free port of the loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder = tmp_path / "server"
    folder.mkdir()
    command = f"""{Path(sys.executable).parent}/mlflow server --host 127.0.0.1 --port {port}
        --workers 1 --backend-store-uri sqlite:///{folder}/server.db
        --artifacts-destination {folder}/files""".split()
    environment = os.environ | {"MLFLOW_DISABLE_TELEMETRY": "true", "PYTHONSAFEPATH": "1"}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            command, stdout=log, stderr=log, env=environment, start_new_session=True
        )
        try:
            yield wait_for(f"http://127.0.0.1:{port}", process, folder / "log")
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(uri: str, process: subprocess.Popen, log: Path) -> str:
    for _ in range(600):
        assert process.poll() is None, log.read_text()
        try:
            urllib.request.urlopen(f"{uri}/health", timeout=1).close()
        except OSError:
            time.sleep(0.1)
        else:
            return uri
    raise AssertionError(log.read_text())


@pytest.mark.slow
def test_a_real_server_takes_and_gives_back_everything(tmp_path: Path, server: str):
    odd = {"psnr": math.inf, "ssim_3dgs": math.nan}
    folders = [write(tmp_path, seed=0), write(tmp_path, seed=1, metrics=odd)]
    assert dies_at("set_tag", folders[0], server) == -signal.SIGKILL
    assert sync(folders, server) == []
    assert sync(folders, server) == []
    assert [run.data.tags[STATE] for run in runs_of(server)] == ["complete"] * 2
    pixels = (folders[0] / "renders" / "dji_0001.png").read_bytes()
    shutil.rmtree(tmp_path / "quick")
    stored = read_results(server)
    assert repr(stored[1].result.metrics) == repr(odd)
    assert stored[0].picture("render", "dji_0001.jpg") == pixels
    assert stored[0].picture("render", "no_such.jpg") is None


def test_a_damaged_record_in_the_store_is_named(tmp_path: Path, uri: str):
    sync([write(tmp_path)], uri)
    (copy,) = (tmp_path / "mlartifacts").rglob("record.json")
    copy.write_text("{")
    with pytest.raises(DataError, match=r"mlflow\.db run \w+: not a result record"):
        read_results(uri)


def test_a_store_whose_making_was_killed_is_made_again(tmp_path: Path):
    """Killed between two of its tables, MLflow's own file could never be opened again."""
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    making = tmp_path / "mlflow.db.making"
    pid = forked(lambda: open_client(uri))
    while not (making.exists() and making.stat().st_size > 50_000):
        assert os.waitpid(pid, os.WNOHANG) == (0, 0)
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    assert ended(pid) == -signal.SIGKILL
    assert not (tmp_path / "mlflow.db").exists()
    assert making.exists()
    open_client(uri)
    assert not list(tmp_path.glob("*.making*"))
    assert read_results(uri) == []


def test_only_the_making_of_a_store_leaves_the_disk_to_the_system(tmp_path: Path):
    """What is logged later waits for the disk, as SQLite does by itself."""
    levels: set[tuple[str, int]] = set()

    def begun(connection: Connection) -> None:
        cursor = connection.connection.cursor()
        (_, _, file), (level,) = (
            cursor.execute(f"PRAGMA {name}").fetchone() for name in ("database_list", "synchronous")
        )
        levels.add((Path(file).name, level))

    event.listen(Engine, "begin", begun)
    try:
        open_client(f"sqlite:///{tmp_path / 'mlflow.db'}")
    finally:
        event.remove(Engine, "begin", begun)
    off, full = 0, 2
    assert levels == {("mlflow.db.making", off), ("mlflow.db", full)}


@pytest.mark.slow  # a process that imports mlflow: seconds
def test_a_store_is_made_quietly_where_mlflow_was_imported_before(tmp_path: Path):
    code = (
        "import mlflow, sys\n"
        "from splatproof.reports.mlflow_client import open_client\n"
        "open_client(sys.argv[1])\n"
    )
    quiet = {k: v for k, v in os.environ.items() if not k.startswith("MLFLOW_")}
    done = subprocess.run(
        [sys.executable, "-c", code, f"sqlite:///{tmp_path}/mlflow.db"],
        env=quiet, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""
