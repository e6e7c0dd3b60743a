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


def test_a_missing_file_is_our_own_fault_and_not_hidden(monkeypatch):
    def command() -> int:
        raise FileNotFoundError(errno.ENOENT, "No such file", "a")

    monkeypatch.setattr(doctor, "doctor", command)
    with pytest.raises(FileNotFoundError):
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
