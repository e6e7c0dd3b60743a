"""What a case costs and what it leaves on disk."""

import os
import subprocess

import pytest

from splatproof.base.errors import DataError
from splatproof.suites import environment as where
from splatproof.suites.case_costs import (
    arrays_sha256,
    bytes_on_disk,
    cpu_seconds,
    timed,
)
from splatproof.suites.environment import commit_of, environment, git_commit, package_version
from splatproof.suites.records import read_record


def test_cpu_seconds_grow_with_work_and_stages_add_up():
    stages: dict[str, float] = {}
    started = cpu_seconds()
    for _ in range(2):
        with timed(stages, "work"):
            sum(range(300_000))
    assert cpu_seconds() > started
    assert stages["work"] > 0


def test_bytes_and_hash_of_a_model(tmp_path):
    (tmp_path / "a.safetensors").write_bytes(b"12345")
    (tmp_path / "model.json").write_text("{}")
    before = arrays_sha256(tmp_path)
    assert bytes_on_disk(tmp_path) == 7
    (tmp_path / "model.json").write_text('{"version": 2}')
    assert arrays_sha256(tmp_path) == before
    (tmp_path / "a.safetensors").write_bytes(b"12346")
    assert arrays_sha256(tmp_path) != before


def test_environment_says_what_a_number_depends_on():
    said = environment("reference")
    assert said["torch"]
    assert said["splatproof"]
    assert int(said["threads"]) >= 1
    assert said["backend"] == "reference"
    assert package_version("no-such-package") == ""
    assert len(git_commit()) in (0, 40, 46)


@pytest.mark.parametrize("ours", [True, False])
def test_commit_of_a_repository_that_the_code_merely_lies_in_is_not_ours(
    tmp_path, monkeypatch, ours
):
    (tmp_path / ".gitignore").write_text("" if ours else ".venv\n")
    code = tmp_path / ".venv" / "environment.py"
    code.parent.mkdir()
    code.write_text("")
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "-m", "theirs"]):
        subprocess.run([*git, *command], check=True)
    monkeypatch.setattr(where, "__file__", str(code))
    assert len(git_commit()) == (40 if ours else 0)


def test_the_commit_of_a_checkout_is_read_and_nothing_is_written_there(tmp_path):
    def git(*words: str) -> str:
        who = ["-c", "user.name=t", "-c", "user.email=t@t"]
        command = ["git", "-C", str(tmp_path), *who, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    git("init")
    file, index = tmp_path / "a.py", tmp_path / ".git/index"
    assert commit_of(file) == ""
    file.write_text("a")
    git("add", "a.py")
    git("commit", "-m", "first")
    head = git("rev-parse", "HEAD")
    assert len(head) == 40
    os.utime(file, ns=(1, 1))  # which `git describe --dirty` would note in the index
    before = index.read_bytes()
    assert commit_of(file) == head
    assert index.read_bytes() == before
    (tmp_path / "untracked").touch()
    assert commit_of(file) == head
    file.write_text("b")
    assert commit_of(file) == f"{head}-dirty"


@pytest.mark.parametrize("found", ["nothing", "binary"])
def test_unreadable_records_are_named(tmp_path, found):
    if found == "binary":
        (tmp_path / "record.json").write_bytes(b"\xff\xfe")
    with pytest.raises(DataError, match="record.json: ") as error:
        read_record(tmp_path)
    assert "\n" not in str(error.value)
