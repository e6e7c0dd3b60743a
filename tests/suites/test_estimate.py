"""Estimates grow with the work and learn from earlier records."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from helpers.tiny_scene import sparse_points
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.registry import METHODS
from splatproof.methods.threedgs.settings import Settings
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import estimate
from splatproof.suites import run_case as cases
from splatproof.suites.environment import usable_cores
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

PROTOCOL = load_protocol("default")
SCENE = fake_scene("town", PROTOCOL)


def case(iterations: int, scene: str = "town") -> Case:
    settings = FakeSettings(iterations=iterations)
    return Case(scene=scene, method="fake", settings=settings, seed=0, protocol=PROTOCOL)


def test_more_iterations_and_more_views_cost_more():
    less, more = (estimate.estimate(case(n), SCENE, "cpu") for n in (1000, 2000))
    assert estimate.START_SECONDS < less.seconds < more.seconds
    assert estimate.BASE_MB < less.memory_mb < more.memory_mb
    assert less.basis == "model"
    assert "not known" in estimate.estimate(case(1), SCENE, "cuda").basis


def test_a_slow_method_is_learnt_from_its_records(tmp_path, monkeypatch):
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    monkeypatch.setattr(estimate, "open_scene", fake_scene)
    fake_methods.register()
    slow = replace(case(20), settings=FakeSettings(iterations=20, seconds_a_step=0.01))
    suite = Suite(name="tiny", description="", cases=(slow, case(20, "broken")), scenes=())
    run_suite(suite, tmp_path, backend="reference", launch=in_process)
    (tmp_path / "tiny" / "rubbish").mkdir()
    (tmp_path / "tiny" / "rubbish" / "record.json").write_text("{")
    longer = replace(slow, settings=FakeSettings(iterations=40, seconds_a_step=0.01))
    whole = Suite(name="tiny", description="", cases=(longer,), scenes=())
    (told,) = estimate.estimate_suite(whole, tmp_path, "reference")
    (blind,) = estimate.estimate_suite(whole, tmp_path / "other", "reference")
    assert "from 1 earlier cases" in told.basis
    assert told.seconds - blind.seconds == pytest.approx(0.4, rel=0.2)


def test_scenes_without_points_cost_what_the_random_ones_do(tmp_path, monkeypatch):
    empty = replace(SCENE, points=sparse_points(torch.zeros(0, 3)))
    monkeypatch.setattr(estimate, "open_scene", lambda scene, protocol: empty)
    row = Case(scene="s", method="3dgs", settings=Settings(), seed=0, protocol=PROTOCOL)
    random = replace(row, settings=Settings(random_points=5000))
    bare, filled = (
        estimate.estimate_suite(
            Suite(name="tiny", description="", cases=(one,), scenes=()), tmp_path, "cpu"
        )[0]
        for one in (row, random)
    )
    assert filled.seconds > bare.seconds
    assert filled.memory_mb > bare.memory_mb


def test_blocks_share_the_gaussians_and_repeat_the_pixels():
    def seconds(**settings: Any) -> float:
        row = Case(
            scene="s", method="stitchgs", settings=CitySettings(iterations=1000, **settings),
            seed=0, protocol=PROTOCOL,
        )  # fmt: skip
        return estimate.estimate(row, SCENE, "cpu").seconds

    one, two, four = (seconds(blocks=k) for k in (1, 2, 4))
    assert one < two < four
    start = estimate.START_SECONDS / usable_cores()
    assert four - two - 2 * start == pytest.approx(2 * (two - one - 2 * start))
    assert seconds(blocks=4, coarse_iterations=500) > four
