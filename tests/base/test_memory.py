"""Peak memory of a process of its own."""

import subprocess
import sys

import pytest

from splatproof.base import memory
from splatproof.base.errors import DataError, MissingError
from splatproof.base.memory import peak_memory_mb


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


def test_a_part_of_a_process_has_a_peak_of_its_own_and_the_whole_keeps_its():
    program = (
        "from splatproof.base.memory import peak_memory_mb as peak, peak_within\n"
        "peaks = {}; block = bytearray(200 * 2**20); del block; before = peak()\n"
        "with peak_within(peaks, 'low'): pass\n"
        "with peak_within(peaks, 'high'): bytearray(100 * 2**20)\n"
        "with peak_within(peaks, 'last'): pass\n"
        "print(before, peaks['low'], peaks['high'], peaks['last'], peak())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    before, low, high, last, after = map(float, done.stdout.split())
    assert before - 210 < low < before - 150
    assert 80 < high - low < 120
    assert abs(last - low) < 20
    assert after == before  # the whole process's


def test_a_peak_that_is_not_known_is_not_kept(monkeypatch):
    monkeypatch.setattr(memory.Path, "write_text", refused)
    peaks: dict[str, float] = {}
    monkeypatch.setattr(memory, "_remembered", iter([100.0, 100.0, 100.0, 120.0]).__next__)
    for name in ("lower", "higher"):
        with memory.peak_within(peaks, name):
            pass
    assert peaks == {"higher": 120.0}


@pytest.mark.parametrize(
    ("own", "files", "free"),
    [
        ("0::/\n", {}, 1000),
        ("0::/\n", {"memory.max": "max", "memory.current": 5}, 1000),
        ("0::/\n", {"memory.max": 900, "memory.current": 500}, 400),
        ("0::/\n", {"memory.max": 900, "memory.current": 800, "memory.stat": ("inactive_file", 300)}, 400),
        ("0::/\n", {"memory.max": 900, "memory.current": 950}, 0),
        ("0::/\n", {"memory.max": 9000, "memory.current": 500}, 1000),
        ("0::/a/b\n", {"a/memory.max": 900, "a/memory.current": 200, "a/b/memory.max": 800, "a/b/memory.current": 300}, 500),
        ("0::/a/b\n", {"a/memory.max": 400, "a/memory.current": 200, "a/b/memory.max": 800, "a/b/memory.current": 300}, 200),
        ("0::/not/seen\n", {"memory.max": 900, "memory.current": 500}, 400),
        ("5:cpu:/a\n4:memory:/a\n0::/\n", {"memory/a/memory.limit_in_bytes": 700, "memory/a/memory.usage_in_bytes": 100,
         "memory/a/memory.stat": ("total_inactive_file", 50), "cpu/a/memory.limit_in_bytes": 1}, 650),
        ("4:hugetlb,memory:/host/path\n", {"memory/memory.limit_in_bytes": 700, "memory/memory.usage_in_bytes": 100}, 600),
    ],
)  # fmt: skip
def test_a_container_is_told_of_what_it_may_take_itself(monkeypatch, tmp_path, own, files, free):
    for name, value in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        row, size = value if isinstance(value, tuple) else ("", value)
        told = size if isinstance(size, str) else f"{row} {size * 2**20}".strip()
        path.write_text(f"{told}\n")
    (tmp_path / "own").write_text(own)
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr(memory, "_machine_mb", lambda: 1000.0)
    assert memory.available_mb() == free


def test_without_control_groups_the_machine_alone_counts(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "none")
    monkeypatch.setattr(memory, "_machine_mb", lambda: 1000.0)
    assert memory.available_mb() == 1000.0


def refused(*_: object) -> int:
    raise PermissionError


def test_what_the_memory_does_not_hold_is_refused(monkeypatch):
    monkeypatch.setattr(memory, "available_mb", lambda: 100.0)
    memory.check_room("a.png", 90 * 2**20)
    with pytest.raises(MissingError, match=r"^a\.png: takes 91 MB to read, more than 90% .*100 MB"):
        memory.check_room("a.png", 91 * 2**20)


def test_what_grows_more_than_any_file_can_is_refused():
    memory.check_growth("a.png", 1032 * 10**6, 10**6)  # the most that deflate reaches
    memory.check_growth("a.png", 64 * 2**20, 1)
    with pytest.raises(DataError, match=r"^a\.png: says that its 1000 bytes hold 1000 MB"):
        memory.check_growth("a.png", 1000 * 2**20, 1000)
