"""A full disk and a folder that may not be written are told in one line, exit code 3."""

import errno
import os
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from splatproof.base.errors import MissingError
from splatproof.cli import doctor, main
from splatproof.reports import mlflow_client


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.ENOSPC, "make room"), (errno.EACCES, "choose another"), (errno.EROFS, "choose")],
)
@pytest.mark.parametrize("path", [None, "there/a.png"])
def test_what_the_disk_has_against_it(monkeypatch, capsys, number, advice, path):
    def command() -> int:
        raise OSError(number, os.strerror(number), path)

    monkeypatch.setattr(doctor, "doctor", command)
    assert main(["doctor"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"bench: {'' if path is None else path + ': '}{os.strerror(number)}; ")
    assert advice in line


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.ENOENT, 2),
        (errno.EISDIR, 2),
        (errno.ENAMETOOLONG, 2),
        (errno.EIO, 3),
        (errno.EMFILE, 3),
    ],
)
def test_whatever_else_the_system_says_is_one_line(monkeypatch, capsys, number, code):
    def command() -> int:
        raise OSError(number, os.strerror(number), "a")

    monkeypatch.setattr(doctor, "doctor", command)
    assert main(["doctor"]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"bench: a: {os.strerror(number)}; ")
    monkeypatch.setenv("SPLATPROOF_DEBUG", "1")
    assert main(["doctor"]) == code
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (OSError("two\nlines"), "two lines; SPLATPROOF_DEBUG=1 shows where"),
        (TimeoutError(), "TimeoutError; SPLATPROOF_DEBUG=1 shows where"),
        (MemoryError(), "out of memory; "),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: x\ny"), "out of memory; "),
    ],
)
def test_faults_without_a_number(monkeypatch, capsys, fault, said):
    def command() -> int:
        raise fault

    monkeypatch.setattr(doctor, "doctor", command)
    assert main(["doctor"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"bench: {said}")


def test_a_fault_of_ours_is_not_hidden(monkeypatch):
    def command() -> int:
        raise RuntimeError("a bug")

    monkeypatch.setattr(doctor, "doctor", command)
    with pytest.raises(RuntimeError, match="a bug"):
        main(["doctor"])


def test_a_store_without_room_is_told_and_leaves_no_half_made_tables(tmp_path, monkeypatch):
    file = tmp_path / "mlflow.db"

    def client(uri: str) -> None:
        Path(uri.removeprefix("sqlite:///")).write_bytes(b"half")
        raise OperationalError("DROP TABLE x", {}, Exception("database or disk is full"))

    monkeypatch.setattr("mlflow.tracking.MlflowClient", client)
    with pytest.raises(MissingError, match="database or disk is full"):
        mlflow_client.open_client(f"sqlite:///{file}")
    assert {path.name for path in tmp_path.iterdir()} == {"mlflow.db.lock"}
