"""Who else uses the machine: seen when somebody does, not seen when nobody does."""

import math
import os
import subprocess
import sys
import time

import pytest

from splatproof.suites.studies.speed import idle


def test_the_machine_tells_its_busy_time_or_nan():
    seconds = idle.busy_seconds()
    assert seconds > 0 or math.isnan(seconds)


def test_own_work_is_ours_and_a_strangers_is_not():
    if math.isnan(idle.busy_seconds()):
        pytest.skip("this system does not tell")
    spin = "import time\nend = time.time() + 20\nwhile time.time() < end: pass"
    other = subprocess.Popen([sys.executable, "-c", spin])
    try:
        while idle.process_seconds(other.pid) < 0.2:
            time.sleep(0.05)
        stranger, friend = idle.Watch([]), idle.Watch([other.pid])
        time.sleep(0.6)
        seen, known = stranger.percent(), friend.percent()
    finally:
        other.kill()
        other.wait()
    # it got what the machine had to give, and that is the difference between the two
    assert seen - known > 5


def test_cpu_of_a_process_is_its_own():
    before = idle.process_seconds(os.getpid())
    end = time.process_time() + 0.1
    while time.process_time() < end:
        pass
    assert 0.05 <= idle.process_seconds(os.getpid()) - before < 1.0
    assert idle.process_seconds(2**31 - 1) == 0.0


def test_patience_ends(monkeypatch):
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.01)
    monkeypatch.setattr(idle.Watch, "percent", lambda self: 99.0)
    patience = idle.Patience(0.05)
    assert patience.wait_for_idle(()) == 99.0
    assert patience.left == 0
    calls = []
    assert idle.undisturbed(lambda: calls.append(1), patience) == (None, 99.0)
    assert len(calls) == 1
    assert idle.undisturbed(lambda: 7, patience, anyway=True) == (7, 99.0)


def test_work_is_repeated_until_nobody_disturbs(monkeypatch):
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.001)
    shares = iter([50.0, 50.0, 2.0, 3.0])  # a run, two looks, the second run
    monkeypatch.setattr(idle.Watch, "percent", lambda self: next(shares))
    calls = []
    assert idle.undisturbed(lambda: len(calls) or calls.append(0), idle.Patience(10.0)) == (1, 3.0)


def test_an_unknown_share_is_no_reason_to_refuse(monkeypatch):
    monkeypatch.setattr(idle.Watch, "percent", lambda self: math.nan)
    assert idle.undisturbed(lambda: 5, idle.Patience(0.0))[0] == 5
