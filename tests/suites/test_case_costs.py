"""What a case costs and what it leaves on disk."""

import subprocess
import sys

import pytest

from splatproof.base.errors import DataError
from splatproof.base.folders import new_folder
from splatproof.base.memory import peak_memory_mb
from splatproof.suites.case_costs import (
    arrays_sha256,
    bytes_on_disk,
    cpu_seconds,
    timed,
)
from splatproof.suites.environment import environment, git_commit, package_version
from splatproof.suites.records import read_record


def test_peak_memory_sees_an_allocation_and_not_the_parents():
    program = (
        "from splatproof.base.memory import peak_memory_mb as peak\n"
        "before = peak(); block = bytearray(200 * 2**20); print(before, peak())"
    )
    held = bytearray(600 * 2**20)  # a child's ru_maxrss would start at our peak
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    before, after = map(float, done.stdout.split())
    assert 150 < after - before < 300
    assert peak_memory_mb() > len(held) / 2**20 > before + 100


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


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "model"
    with new_folder(target) as folder:
        (folder / "a").write_text("old")
        assert not target.exists()
    with pytest.raises(IsADirectoryError), new_folder(target) as folder:  # noqa: PT012
        (folder / "a").mkdir()
        (folder / "a").write_text("half")
    assert (target / "a").read_text() == "old"
    (tmp_path / "model.partial").mkdir()
    (tmp_path / "model.partial" / "rubbish").write_text("of a kill")
    with new_folder(target) as folder:
        (folder / "b").write_text("new")
    assert [path.name for path in target.iterdir()] == ["b"]
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_environment_says_what_a_number_depends_on():
    said = environment("reference")
    assert said["torch"]
    assert said["splatproof"]
    assert int(said["threads"]) >= 1
    assert said["backend"] == "reference"
    assert package_version("no-such-package") == ""
    assert len(git_commit()) in (0, 40, 46)


@pytest.mark.parametrize("found", ["nothing", "binary"])
def test_unreadable_records_are_named(tmp_path, found):
    if found == "binary":
        (tmp_path / "record.json").write_bytes(b"\xff\xfe")
    with pytest.raises(DataError, match="record.json: ") as error:
        read_record(tmp_path)
    assert "\n" not in str(error.value)
