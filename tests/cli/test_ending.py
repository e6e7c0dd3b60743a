"""Ctrl-C and SIGTERM end a command with one line and the usual exit code; nothing half-made is left."""

import os
import signal
import subprocess
import sys
import time
import tomllib
from contextlib import suppress
from pathlib import Path

import pytest

from helpers.aerial_photos import write_flight
from helpers.colmap_scenes import Flight, write_scene
from splatproof.base.processes import how_it_ended
from splatproof.cli import ending

BENCH = str(Path(sys.executable).with_name("bench"))
SUITE = """
description = "For tests"
[[cases]]
scenes = ["./town"]
methods = ["3dgs"]
protocols = ["default"]
[cases.settings.3dgs]
iterations = 1_000_000
"""


def started(arguments: list[str], folder: Path, sign: str) -> subprocess.Popen[str]:
    """A command in a session of its own, once a line of its stderr begins as told."""
    process = subprocess.Popen(
        [BENCH, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(sign):
            time.sleep(0.5)
            return process
    raise AssertionError(f"never said {sign!r}: {how_it_ended(process.wait())}")


def ended(process: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str]:
    """Exit code and what was still said, after the signal that a terminal or a batch system sends."""
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # a terminal tells the workers too
    else:
        process.send_signal(number)
    try:
        said, errors = process.communicate(timeout=120)
    finally:
        with suppress(ProcessLookupError):  # what did not hear must not go on for ever
            os.killpg(process.pid, signal.SIGKILL)
    assert said == ""
    return process.returncode, errors


KILLS_ITSELF = """
import os, signal, sys
class At:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["AT"]:
            os.kill(os.getpid(), int(os.environ["BY"]))
sys.meta_path.insert(0, At())
"""


@pytest.mark.parametrize("at", ["splatproof.cli", "inspect", "tyro", "splatproof.cli.ending"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_still_loading_ends_in_one_line(tmp_path, at, number):
    """The signal comes when the console script begins to import a module."""
    (tmp_path / "sitecustomize.py").write_text(KILLS_ITSELF)
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    module, _, function = project["scripts"]["bench"].partition(":")
    script = f"import sys; from {module} import {function} as run; sys.exit(run())"
    ended = subprocess.run(
        [sys.executable, "-c", script, "scenes", "list"], text=True, check=False, capture_output=True,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "AT": at, "BY": str(int(number))},
    )  # fmt: skip
    how = {signal.SIGTERM: "terminated", signal.SIGINT: "interrupted"}[number]
    assert ended.returncode == 128 + number
    assert ended.stderr == f"bench: {how}; the same command continues where it stopped\n"
    assert ended.stdout == ""


CASES = [
    pytest.param("ingest", signal.SIGTERM, marks=pytest.mark.slow),
    pytest.param("run", signal.SIGINT, marks=pytest.mark.slow),
    pytest.param("fit", signal.SIGTERM, marks=pytest.mark.slow),
    pytest.param("ingest", signal.SIGINT, marks=pytest.mark.slow),
    pytest.param("fit", signal.SIGINT, marks=pytest.mark.slow),
    pytest.param("run", signal.SIGTERM, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("command", "number"), CASES)
def test_one_line_and_the_usual_exit_code(tmp_path, command, number):
    if command == "ingest":
        write_flight(tmp_path / "photos")
        process = started(["ingest", "photos", "scene"], tmp_path, "features")
    elif command == "fit":
        write_scene(tmp_path / "town", Flight())
        settings = ["--iterations", "1000000", "--out", "runs"]
        process = started(["fit", "3dgs", "town", *settings], tmp_path, "[1/1]")
    else:
        write_scene(tmp_path / "town", Flight())
        (tmp_path / "mine.toml").write_text(SUITE)
        process = started(["run", "mine.toml"], tmp_path, "[1/1]")
    code, errors = ended(process, number)
    how = {signal.SIGTERM: "terminated", signal.SIGINT: "interrupted"}[number]
    assert errors == f"bench: {how}; the same command continues where it stopped\n"
    assert code == 128 + number
    left = {path.name for path in (tmp_path / "runs").rglob("*")}
    assert not left & {"record.json", "model", "model.partial"}
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize(
    ("number", "how"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")]
)
def test_what_an_import_makes_of_a_signal_is_the_signals(number, how, capsys):
    def imported() -> int:
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            raise RuntimeError("initialization failed") from None
        return 0

    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]
    assert ending.ended(imported) == 128 + number
    assert capsys.readouterr().err == f"bench: {how}; the same command continues where it stopped\n"
    assert [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize(
    ("number", "how"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")]
)
def test_a_signal_that_comes_inside_a_destructor_is_not_lost(number, how, capsys):
    """Python prints a traceback of what is raised there, drops it and goes on."""

    class Dying:
        def __del__(self) -> None:
            signal.raise_signal(number)

    def action() -> int:
        Dying()
        time.sleep(20)
        return 0

    before = sys.unraisablehook, signal.getsignal(signal.SIGALRM), signal.getsignal(number)
    began = time.perf_counter()
    assert ending.ended(action) == 128 + number
    assert time.perf_counter() - began < 10
    assert capsys.readouterr().err == f"bench: {how}; the same command continues where it stopped\n"
    assert before == (
        sys.unraisablehook,
        signal.getsignal(signal.SIGALRM),
        signal.getsignal(number),
    )


def test_other_errors_of_a_destructor_are_told_as_ever(monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: told.append(lost.exc_type))

    class Dying:
        def __del__(self) -> None:
            raise ValueError

    def action() -> int:
        Dying()
        return 0

    assert ending.ended(action) == 0
    assert told == [ValueError]


def test_our_own_faults_are_raised():
    def wrong() -> int:
        raise RuntimeError("of ours")

    with pytest.raises(RuntimeError, match="of ours"):
        ending.ended(wrong)


PYCOLMAP = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException as error:
    raise RuntimeError("Cannot import the C++ backend") from error
"""
"""Does what the real one does when ctrl-C comes while it is imported."""


def test_ctrl_c_waits_for_the_import_of_pycolmap(tmp_path):
    (tmp_path / "pycolmap.py").write_text(PYCOLMAP)
    done = subprocess.run(
        [sys.executable, "-c", "import splatproof.datasets.colmap_library"], text=True,
        capture_output=True, check=False, env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.stderr.splitlines()[-1] == "KeyboardInterrupt"
