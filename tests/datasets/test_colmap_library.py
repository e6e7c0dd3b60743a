"""pycolmap is imported late, in one place, and takes no signal for itself."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("reference", "metrics", "datasets", "methods", "suites", "reports", "cli", "base")
IMPORTS = """
import importlib, signal, sys
def end(*_):
    sys.exit(9)
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, end)
before = [signal.getsignal(number) for number in signal.valid_signals()]
{work}
assert before == [signal.getsignal(number) for number in signal.valid_signals()]
signal.raise_signal(signal.{name})
"""


def _ends_by_our_handler(work: str, name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS.format(work=work, name=name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stderr, done.returncode) == ("", 9)


def test_importing_the_rooms_brings_no_pycolmap_and_leaves_signals_alone():
    work = f"for room in {ROOMS}: importlib.import_module('splatproof.' + room)\n"
    _ends_by_our_handler(work + "assert 'pycolmap' not in sys.modules", "SIGTERM")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signals_are_ours_after_pycolmap_worked(name):
    work = """
from splatproof.datasets.adapters.posed import pinhole_camera
pinhole_camera(4, 3, 2.0, 2.0, 2.0, 1.5)
assert "pycolmap" in sys.modules
"""
    _ends_by_our_handler(work, name)


def test_pycolmap_is_imported_in_one_place():
    """The one place gives the signals back; a test may import pycolmap as it likes."""
    found = []
    for room in ROOMS:
        for path in (ROOT / "src/splatproof" / room).rglob("*.py"):
            text = path.read_text()
            if "pycolmap" not in text:  # to parse all files takes seconds
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Import) and "pycolmap" in [a.name for a in node.names]:
                    found.append(path.name)
    assert found == ["colmap_library.py"]
