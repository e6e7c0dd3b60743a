"""Times are judged where the machine was one, undisturbed and shared turn by turn."""

import dataclasses

import numpy as np
import pytest

from helpers.compared_sides import band, case
from splatproof.reference.types.result import BEGAN, BOOT, ENDED
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.sides import Side

BANDS = {"train_seconds": band(0.02, "relative"), "psnr": band(0.1)}


def timed(label: str, turns: list[int], seconds: float, work: float = 1.0, **where: str) -> Side:
    """A side whose runs began in these minutes of an hour."""
    rng = np.random.default_rng(turns)
    cases = []
    for seed, turn in enumerate(turns):
        environment = {BOOT: "one", "cpu": "x", "cores": "2", "threads": "1", "simd": "avx2",
                       BEGAN: f"2026-01-01T10:{turn:02}:00.000+00:00",
                       ENDED: f"2026-01-01T10:{turn:02}:50.000+00:00"} | where  # fmt: skip
        wall = seconds + rng.normal(0, 0.05)
        values = {
            "train_seconds": wall,
            "cpu_seconds": work * wall,
            "render_ms": 10.0 + rng.normal(0, 0.1),
        }
        cases.append(
            case(
                "scene_0",
                seed,
                {"psnr": rng.normal(20, 1, 4)},
                values=values,
                environment=environment,
            )
        )
    return Side(label=label, cases=tuple(cases))


def verdict(base: Side, new: Side) -> tuple[str, str]:
    found = compare(base, new, metrics=["train_seconds"], bands=BANDS)
    return found.compared[0].verdict, found.compared[0].reason


@pytest.mark.parametrize(
    ("base", "new"), [([0, 2, 4], [1, 3, 5]), ([0, 3, 4], [1, 2, 5]), ([0, 1, 4], [2, 3, 5])]
)
def test_turns_are_judged(base: list[int], new: list[int]):
    assert verdict(timed("a", base, 40.0), timed("b", new, 50.0))[0] == "worse"
    assert verdict(timed("a", base, 40.0), timed("b", new, 30.0))[0] == "better"


@pytest.mark.parametrize(("base", "new"), [([0, 1, 2], [3, 4, 5]), ([0, 1, 3], [2, 4, 5])])
def test_one_side_after_the_other_is_not_judged(base: list[int], new: list[int]):
    said = verdict(timed("a", base, 40.0), timed("b", new, 50.0))
    assert said[0] == "not judged"
    assert "not interleaved" in said[1]


@pytest.mark.parametrize(
    ("where", "why"),
    [
        ({BOOT: "two"}, "another start of the machine, or another one"),
        ({"cpu": "y"}, "other cpu"), ({"threads": "2"}, "other threads"), ({BEGAN: ""}, "do not say when"),
    ],
)  # fmt: skip
def test_another_machine_is_never_judged(where: dict[str, str], why: str):
    said = verdict(timed("a", [0, 2, 4], 40.0), timed("b", [1, 3, 5], 50.0, 1.0, **where))
    assert said[0] == "not judged"
    assert why in said[1]


def test_runs_that_waited_for_other_work_are_not_judged():
    said = verdict(timed("a", [0, 2, 4], 40.0), timed("b", [1, 3, 5], 50.0, work=0.8))
    assert said[0] == "not judged"
    assert "other work (s/scene_0/3dgs/p/seed0)" in said[1]


def test_what_is_not_judged_is_no_test_and_its_means_are_shown():
    base, new = timed("a", [0, 1, 2], 40.0), timed("b", [3, 4, 5], 50.0)
    found = compare(base, new, bands=BANDS)
    (seconds,) = [one for one in found.compared if one.measure.metric == "train_seconds"]
    assert (round(seconds.base_mean), round(seconds.new_mean)) == (40, 50)
    assert seconds.p is None
    assert found.tests == 1  # psnr alone
    assert not found.regressions


def test_the_same_models_times_are_judged_all_the_same():
    """Identical results need no test, but how long they took does."""
    base = timed("a", [0, 2, 4], 40.0)
    new = timed("b", [1, 3, 5], 50.0)
    cases = tuple(
        dataclasses.replace(c, model=b.model, measured=dataclasses.replace(c.measured, images=b.measured.images))
        for b, c in zip(base.cases, new.cases, strict=True)
    )  # fmt: skip
    found = compare(base, dataclasses.replace(new, cases=cases), bands=BANDS)
    assert {o.measure.metric: o.verdict for o in found.compared} == {
        "psnr": "equal", "train_seconds": "worse",
    }  # fmt: skip
