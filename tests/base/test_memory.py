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
