"""Killed and started again, commands end as undisturbed ones; the harness sees what it should see."""

import random
import sys
import time

import pytest

from torture import kills
from torture.commands import COMMANDS, Command, contents
from torture.kills import Kill
from torture.rounds import Torture

IN_THE_WORK = Kill(0.85, ("SIGKILL",), "process")
"""Imports take half the time of such small work; then it trains and writes."""


# the slow suite kills every command
def test_a_fit_that_was_killed_and_continued_equals_an_undisturbed_one(tmp_path):
    assert Torture("fit", COMMANDS["fit"], tmp_path).killed([IN_THE_WORK]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_round_of_random_kills(tmp_path, name):
    assert Torture(name, COMMANDS[name], tmp_path).round(0) == []


STUB = """
import os, signal, subprocess, sys, time
from pathlib import Path
fault = sys.argv[1]
Path("begun").touch()
if fault == "orphan":
    subprocess.Popen(["sleep", "30"])
if fault == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if fault == "half":
    Path("out").write_text("half")
again = Path("killed").exists()
Path("killed").touch()
time.sleep(2 if not again or fault == "deaf" else 0)
if fault != "traceback":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
Path("out").write_text("other" if fault == "differs" and again else "whole")
if fault == "left":
    Path("out.1.partial").touch()
"""
"""A command that is slow the first time, with a fault by name."""


def stub(fault: str) -> Command:
    return Command(
        program=(sys.executable, "-c", STUB), arguments=(fault,), prepare=lambda folder: None,
        outcome=contents("out"), whole=("out",),
    )  # fmt: skip


SEEN = {
    "none": (("SIGKILL",), ""), "orphan": (("SIGKILL",), "orphan after 2 s: sleep 30"),
    "half": (("SIGKILL",), "half-made: out"), "differs": (("SIGTERM",), "differs: out"),
    "left": (("SIGTERM",), "left over: out.1.partial"),
    "traceback": (("SIGINT",), "a traceback, exit code -2: KeyboardInterrupt"),
}  # fmt: skip


@pytest.mark.parametrize("fault", SEEN)
def test_a_planted_fault_is_seen(tmp_path, fault):
    signals, said = SEEN[fault]
    torture = Torture(f"stub {fault}", stub(fault), tmp_path)
    faults = torture.killed([Kill(0.25, signals, "process")])
    assert bool(faults) == bool(said)
    assert all(said in one for one in faults)


def test_a_command_that_does_not_end_is_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(kills, "ENDS", 0.3)
    torture = Torture("stub deaf", stub("deaf"), tmp_path)
    faults = torture.killed([Kill(0.25, ("SIGTERM",), "process")])
    assert [fault.split(": ")[-1] for fault in faults] == ["does not end within 0 s"]


def test_what_is_drawn_depends_on_the_seed_alone():
    draws = [[kills.drawn(random.Random(seed)) for _ in range(3)] for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]


def test_a_mark_finds_its_processes(tmp_path):
    process = kills.started(stub("none"), tmp_path, "mark-of-this-test")
    try:
        until = time.monotonic() + 10
        while process.pid not in kills.marked("mark-of-this-test"):
            assert time.monotonic() < until
        assert list(kills.marked("mark-of-another")) == []
    finally:
        process.kill()
        process.wait()
