"""Estimates grow with the work and learn from earlier records."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from helpers.tiny_scene import sparse_points
from splatproof.base.errors import UsageError
from splatproof.methods.city.cost import START_SECONDS
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.contracts.method import Cost
from splatproof.methods.registry import METHODS, get_method
from splatproof.methods.threedgs.cost import PROCESS_MB
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


@pytest.fixture(autouse=True)
def fake(monkeypatch):
    monkeypatch.setitem(METHODS, "fake", None)  # removed again after the test
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()


def test_more_iterations_and_more_views_cost_what_the_method_says():
    less, more = (estimate.estimate(case(n), SCENE, "cpu") for n in (1000, 2000))
    assert more.seconds - less.seconds == pytest.approx(0.01 * 1000 * 4 / usable_cores())
    assert (less.memory_mb, more.memory_mb) == (4000, 8000)
    assert less.basis == "the method's own estimate"
    assert "not known" in estimate.estimate(case(1), SCENE, "cuda").basis


@pytest.mark.parametrize(
    ("cost", "said"),
    [
        (lambda settings, scene: 1 / 0, "ZeroDivisionError: division by zero"),  # pyrefly: ignore[division-by-zero]
        (lambda settings, scene: None, "AttributeError"),
        (lambda settings, scene: Cost(cpu_seconds=-1.0, memory_mb=1.0), "expected 0 or more"),
    ],
)
def test_a_cost_that_fails_is_named_in_one_line(monkeypatch, cost, said):
    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], cost=cost))
    with pytest.raises(UsageError, match=f"method fake: its cost fails .*{said}.*; mend it"):
        estimate.estimate(case(1), SCENE, "cpu")


def test_3dgs_says_more_for_more_iterations_and_larger_models():
    def cost(**settings: Any) -> Cost:
        return get_method("3dgs").cost(Settings(**settings), SCENE)

    short, long = cost(iterations=1000), cost(iterations=2000)
    assert 0 < short.cpu_seconds < long.cpu_seconds
    assert PROCESS_MB < short.memory_mb < long.memory_mb
    assert cost(iterations=1000, views_per_step=2).cpu_seconds > short.cpu_seconds


def test_a_slow_method_is_learnt_from_its_records(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    monkeypatch.setattr(estimate, "open_scene", fake_scene)
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
    # 40 steps of 0.01 s, where the method said 0.01 CPU s a step and view on all cores
    said = 0.01 * 40 * 4 / usable_cores()
    assert told.seconds - blind.seconds == pytest.approx(0.4 - said, abs=0.1)


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
    start = START_SECONDS / usable_cores()
    assert four - two - 2 * start == pytest.approx(2 * (two - one - 2 * start))
    assert seconds(blocks=4, coarse_iterations=500) > four


def test_a_refinement_in_parts_costs_what_its_parts_do_and_no_process_holds_the_whole_in_training():
    crowded = replace(SCENE, points=sparse_points(torch.rand(100_000, 3)))

    def cost(parts: bool, **settings: Any) -> Cost:
        refine = RefineSettings(iterations=2000, parts=parts)
        row = CitySettings(iterations=1000, gcr=True, blocks=4, refine=refine, **settings)
        return get_method("stitchgs").cost(row, crowded)

    whole, apart = cost(False), cost(True)
    assert apart.memory_mb < 0.8 * whole.memory_mb
    # as many steps together, each over a fourth of the Gaussians, and a start of each part's process
    assert 0 < apart.cpu_seconds - 4 * START_SECONDS < whole.cpu_seconds
    assert cost(True, coarse_iterations=500).memory_mb == pytest.approx(whole.memory_mb)
