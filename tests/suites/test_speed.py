"""The speed study on tiny cases."""

import math

import torch

from splatbench.suites.studies import speed
from splatbench.suites.studies.speed_scenes import speed_scene
from splatbench.suites.studies.study import STUDIES

KEYS = {"component", "twin", "case", "forward_ms", "backward_ms", "max_abs_error", "grad_rel_l2",
        "step_pixels", "peak_mb", "disturbed_percent", "error_case", "ok", "note"}  # fmt: skip


def test_every_twin_is_a_row_within_its_tolerance():
    twins = speed.rasterizers(50, 32, 24) + speed.losses(24, 20) + speed.optimizers(40)
    rows = list(speed.timed(twins, 1))
    assert {row["component"] for row in rows} == {"rasterizer", "loss", "adam"}
    for row in rows:
        assert set(row) == KEYS
        assert row["ok"], row
        assert row["forward_ms"] > 0


def test_an_error_is_not_ok():
    twin = speed.optimizers(10)[0]
    twin.error["max_abs_error"] = 1e-3
    assert not next(speed.timed([twin], 1))["ok"]


def test_scenes_repeat_and_differ():
    one, again, other = (speed_scene(50, w, 24) for w in (32, 32, 33))
    assert torch.equal(one[0].sh, again[0].sh)
    assert torch.equal(one[1], again[1])
    assert not torch.equal(one[0].means, other[0].means)


def test_the_machine_tells_its_busy_time_or_nan():
    seconds = speed.busy_seconds()
    assert seconds > 0 or math.isnan(seconds)


def test_the_study_is_registered():
    assert set(STUDIES["speed"].columns) <= KEYS
