"""Killed at any moment and started again, a suite ends as if nothing had happened."""

import fcntl
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from helpers import run_fake_suite
from splatproof.reference.types.result import Result
from splatproof.reports.store import read_results
from splatproof.suites.records import read_record

pytestmark = pytest.mark.slow  # tests/torture kills a fit and an export in every run of the tests
FAKE = [sys.executable, str(Path(run_fake_suite.__file__))]
BENCH = [str(Path(sys.executable).with_name("bench")), "run", "quick", "--quiet", "--out"]
HANGS = 600
"""Seconds after which a test gives up; a start of seconds takes minutes on a machine with much other work."""


def essence(result: Result) -> Result:
    """The result without what depends on the clock and the machine."""
    return replace(
        result, stages={}, cpu_seconds=0.0, peak_memory_mb=0.0, render_ms=0.0, environment={},
        curve_seconds=(),
    )  # fmt: skip


def records(out: Path) -> dict[str, Result]:
    folders = sorted(path.parent for path in out.rglob("record.json"))
    return {str(folder.relative_to(out)): essence(read_record(folder)) for folder in folders}


def pictures(out: Path) -> dict[str, bytes]:
    folders = ("renders", "truth", "errors")
    files = [path for name in folders for path in out.rglob(f"{name}/*.png")]
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def start(command: list[str], out: Path) -> subprocess.Popen[bytes]:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    return subprocess.Popen([*command, str(out)], env=environment, stdout=subprocess.DEVNULL)


def finish(command: list[str], out: Path) -> None:
    assert start(command, out).wait(timeout=1200) == 0


def kill_after(command: list[str], out: Path, delay: float) -> None:
    """Start, wait until a case runs, end the process without a word some time later.

    Its worker must then end by itself.
    """
    process = start(command, out)
    wait_until(lambda: at_work(out) or process.poll() is not None, HANGS)
    time.sleep(delay)
    process.kill()
    process.wait()
    wait_until(lambda: not at_work(out), 10)


def at_work(out: Path) -> bool:
    """Whether the worker of a case is alive: it holds a lock."""
    for path in out.rglob(".worker"):
        with path.open("r+") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
    return False


def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < seconds
        time.sleep(0.01)


def assert_same_end(killed: Path, undisturbed: Path) -> None:
    assert records(killed) == records(undisturbed)
    assert pictures(killed) == pictures(undisturbed)
    assert pictures(killed)
    assert not list(killed.rglob("*.partial"))
    assert not list(killed.rglob("checkpoint"))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed")
    finish(FAKE, out)
    return out


def test_killed_and_continued_equals_undisturbed(tmp_path, undisturbed):
    draw = random.Random(3)
    for _ in range(3):
        kill_after(FAKE, tmp_path, draw.uniform(0, 1.5))
    finish(FAKE, tmp_path)
    assert_same_end(tmp_path, undisturbed)


def test_a_case_alone_killed_and_continued_is_that_of_the_suite(tmp_path, undisturbed):
    draw = random.Random(5)
    alone, first = tmp_path / "alone", undisturbed / "tiny/town/fake/default/seed0"
    command = [*FAKE, "alone"]
    for _ in range(2):
        kill_after(command, alone, draw.uniform(0, 1.5))
    finish(command, alone)
    (found,), (whole, _) = records(alone).values(), records(undisturbed).values()
    assert found == replace(whole, suite="fit", suite_scenes=())
    assert pictures(alone) == pictures(first)
    assert pictures(alone)
    assert not list(tmp_path.rglob("*.partial"))
    assert not (alone / "checkpoint").exists()


def test_the_comparison_sees_another_seed(undisturbed):
    one, two = records(undisturbed).values()
    assert replace(one, seed=two.seed) != two


@pytest.mark.slow
def test_the_quick_suite_killed_twenty_times(tmp_path):
    draw = random.Random(7)
    finish(BENCH, tmp_path / "undisturbed")
    for _ in range(20):
        kill_after(BENCH, tmp_path / "killed", draw.uniform(0, 12))
    finish(BENCH, tmp_path / "killed")
    assert_same_end(tmp_path / "killed", tmp_path / "undisturbed")
    for out in ("killed", "undisturbed"):
        stored = read_results(f"sqlite:///{tmp_path / out / 'mlflow.db'}")
        logged = {f"{r.suite}/{r.scene}/{r.method}/{r.protocol}/seed{r.seed}": essence(r)
                  for r in (one.result for one in stored)}  # fmt: skip
        assert logged == records(tmp_path / out)
        assert len(stored) == len(logged)
