"""The name of the code that results of a check lie under."""

from pathlib import Path

import pytest

from splatproof.base.errors import UsageError
from splatproof.base.plugin_files import forget_plugin_file, load_plugin_file
from splatproof.testing.code_key import code_key

METRIC = """
from splatproof.metrics.registry import Metric

def largest(image, target, mask):
    return float((image - target).abs().max())

largest_error = Metric(
    name="largest_error", function=largest, unit="", higher_is_better=False, range=(0.0, 1.0), source="a test"
)
"""


def test_the_code_of_a_metric_is_part_of_the_key(tmp_path: Path):
    file = tmp_path / "own_metric_of_a_key.py"
    file.write_text(METRIC)
    loaded = load_plugin_file(file)
    try:
        names = ["psnr", "largest_error"]
        before = code_key(["3dgs"], names)
        assert code_key(["3dgs"], names) == before
        assert code_key(["3dgs"], ["psnr"]) == code_key(["3dgs"], []) != before
        file.write_text(METRIC.replace(".max()", ".amax()"))
        assert code_key(["3dgs"], names) != before
    finally:
        forget_plugin_file(loaded)


def test_the_code_of_a_partial_function_is_part_of_the_key(tmp_path: Path):
    """Its module is functools."""
    file = tmp_path / "own_partial_metric.py"
    text = METRIC.replace("function=largest", "function=partial(largest)")
    file.write_text(f"from functools import partial\n{text}")
    loaded = load_plugin_file(file)
    try:
        before = code_key(["3dgs"], ["largest_error"])
        file.write_text(file.read_text().replace(".max()", ".amax()"))
        assert code_key(["3dgs"], ["largest_error"]) != before
    finally:
        forget_plugin_file(loaded)


def test_a_metric_that_there_is_not_is_named():
    with pytest.raises(UsageError, match="no-such"):
        code_key(["3dgs"], ["no-such"])
