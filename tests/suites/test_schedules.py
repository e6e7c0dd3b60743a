"""No row of any suite trains without densification, and no block of one."""

from functools import cache
from typing import Any

import pytest

from splatproof.methods.anchors.control import AnchorControl, AnchorDensity
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import DensityControl
from splatproof.suites.suite_files import load_suite, suite_names


@cache  # hundreds of rows share a schedule
def times(density: Any, iterations: int) -> int:
    """How often a schedule densifies in a run of some length."""
    steps = range(1, iterations + 1)
    if isinstance(density, Density):
        control = DensityControl(density, iterations=iterations, extent=1.0)
        return sum(control.densifies(step) for step in steps)
    if isinstance(density, AnchorDensity):
        anchors = AnchorControl(density, iterations=iterations, voxel=1.0, extent=1.0, k=1)
        return sum(anchors.adjusts(step) for step in steps)
    assert isinstance(density, HdgsDensity), type(density)
    now = density.shrunk(iterations)
    return sum(now.start < step < now.stop and step % now.interval == 0 for step in steps)


def lengths(settings: Any) -> list[int]:
    """Steps of each training that a row's settings ask for."""
    found = [settings.iterations, getattr(settings, "coarse_iterations", 0)]
    return [steps for steps in found if steps]


@pytest.mark.parametrize("suite", suite_names())
def test_every_row_densifies(suite):
    for case in load_suite(suite).cases:
        density = getattr(case.settings, "density", None)
        if density is None:  # chosen for the scene while it runs
            assert case.method == "auto"
            continue
        for steps in lengths(case.settings):
            few = 3 if suite == "city" else 1
            assert times(density, steps) >= few, f"{case.label}: {steps} steps"


def test_what_blocks_of_suite_city_once_had_is_seen():
    assert times(Density(start=7500), 400) == times(Density(start=7500), 200) == 0
