"""Fuzzing by coverage reaches further than the intact files, and sees a fault."""

import importlib.util

import pytest

from fuzz import guided

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("atheris") is None, reason="needs atheris: make fuzz-guided"
    ),
]


def test_readers_in_python_stand_what_reaches_new_lines():
    found = guided.run(["suite", "gaussians ply", "packed", "transforms.json"], 20)
    for name, read in found.items():
        assert read.faults == [], name
        assert read.inputs > 100, name
        assert read.covered > 0, f"{name}: nothing of ours is instrumented"


def test_a_reader_that_is_not_there_is_a_fault():
    found = guided.run(["no such reader"], 1)
    assert "KeyError" in found["no such reader"].faults[0]
