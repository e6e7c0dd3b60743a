"""Completed depths in the plan: when, what follows of the settings, and what they are counted as."""

from dataclasses import replace
from functools import cache

import pytest
import torch

from helpers.aerial_scene import aerial_scene, without_points
from splatproof.base.errors import UsageError
from splatproof.methods.auto.base import started
from splatproof.methods.auto.choices import NOT_MEASURED
from splatproof.methods.auto.completion import (
    DROPOUT,
    ENOUGH,
    FEW,
    LEAST,
    RESETS_FROM,
    SEEN,
    completing,
    planned_completion,
    sized,
    too_slow,
)
from splatproof.methods.auto.facts import facts_of
from splatproof.methods.auto.fit import Planned, fit, planned
from splatproof.methods.auto.measured import COMPLETED, EXPLICIT
from splatproof.methods.auto.method import cost
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.usual import usual
from splatproof.methods.contracts.run import Run
from splatproof.methods.training import initialise
from splatproof.methods.training.fewer_points import with_at_most

FACTS = facts_of(aerial_scene())
ASKED = AutoSettings(seconds=20.0, probe_share=0.0)


AERIAL = replace(FACTS, views=6, coverage=2.5, down=1.0)


@cache
def plan_of(asked: AutoSettings) -> Planned:
    """The plan for the scene, made once."""
    return planned(aerial_scene().for_training(), asked, Run(threads=1))


@pytest.mark.parametrize(
    ("known", "done", "because", "expects"),
    [
        ({}, True, "each place is in 2.5 of 6 photos", f"{COMPLETED}; the pictures are better"),
        ({"coverage": SEEN}, False, "each place is in 4.0 of 6 photos", str(EXPLICIT)),
        ({"down": 0.0}, False, "a photo looks 90 degrees away from straight down", NOT_MEASURED),
    ],
)
def test_depths_are_completed_where_few_photos_from_the_air_see_a_place(
    known, done, because, expects
):
    found, (choice,) = planned_completion(ASKED, replace(AERIAL, **known), points=9, moves=False)
    assert (found, choice.because, choice.expects) == (done, because, expects)


def test_a_gain_is_expected_only_for_the_reason_that_it_was_measured_for():
    bounded = replace(ASKED, megabytes=2.0)
    others = [
        planned_completion(ASKED, AERIAL, points=0, moves=False)[1],
        planned_completion(bounded, AERIAL, points=9, moves=False)[1],
        *(planned_completion(replace(ASKED, completed=done), AERIAL, points=9, moves=False)[1] for done in (True, False)),
        (too_slow(9),),
    ]  # fmt: skip
    assert [choice.expects for (choice,) in others] == [NOT_MEASURED] * 5


def test_nothing_is_completed_where_nobody_would_expect_it():
    assert planned_completion(ASKED, replace(AERIAL, views=FEW + 1), points=9, moves=False) == (
        False,
        (),
    )
    assert planned_completion(ASKED, AERIAL, points=9, moves=True) == (False, ())


def test_without_any_point_nothing_is_completed_and_training_starts_all_the_same():
    found, (choice,) = planned_completion(ASKED, AERIAL, points=0, moves=False)
    assert (found, choice.because) == (False, "the scene has no point")
    scene = without_points(aerial_scene().for_training())
    assert fit(scene, replace(ASKED, steps=20), Run(threads=1)).kind == "explicit"


def test_points_are_matched_for_the_completion_only_where_that_is_planned():
    asked = replace(ASKED, completed=True, dense_cell=0.0)
    assert (
        planned(aerial_scene().for_training(), asked, Run(threads=1)).plan.settings.dense_cell == 0
    )


def test_a_bound_on_the_file_leaves_no_room_for_virtual_gaussians():
    found, (choice,) = planned_completion(
        replace(ASKED, megabytes=2.0), AERIAL, points=9, moves=False
    )
    assert not found
    assert choice.because.startswith("megabytes is given")
    with pytest.raises(
        UsageError, match="completed is True, expected False, or None, where megabytes"
    ):
        AutoSettings(completed=True, megabytes=2.0)


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("views", [3, 100])
def test_what_is_fixed_is_kept(fixed, views):
    asked = replace(ASKED, completed=fixed)
    found, (choice,) = planned_completion(
        asked, replace(AERIAL, views=views), points=9, moves=False
    )
    assert (found, choice.because) == (fixed, "given")


def test_what_moves_is_not_completed():
    with pytest.raises(UsageError, match="completed is True, expected 0, or None, where motion"):
        AutoSettings(motion=True, completed=True)


def test_the_number_of_completed_points_is_planned_with():
    scene = aerial_scene().for_training()
    found = planned(scene, replace(ASKED, completed=True), Run(threads=1))
    assert found.start is not None
    assert len(found.start.points) > len(scene.points)
    told = {choice.component: choice for choice in found.plan.choices}
    assert told["points"].value.startswith(f"{len(found.start.points):,} of ")
    assert planned(scene, replace(ASKED, completed=False), Run(threads=1)).start is None


def test_memory_is_told_of_completed_depths_where_they_may_be():
    scene = aerial_scene().for_training()
    plain, may, asked = (
        cost(replace(ASKED, completed=fixed), scene).memory_mb for fixed in (False, None, True)
    )
    assert plain < may == asked
    many = replace(scene, train=scene.train * FEW)
    assert cost(ASKED, many).memory_mb < cost(replace(ASKED, completed=True), many).memory_mb


def test_what_is_fixed_of_the_settings_stays():
    plain = usual(ASKED, FACTS)
    assert completing(plain, ASKED).dropout == DROPOUT
    asked = replace(
        ASKED,
        dropout=0.1,
        opacity_weight=0.3,
        coarsest=4.0,
        gradient=1e-3,
        most_points=77,
        split_gradient=5e-3,
    )
    found = completing(usual(asked, FACTS), asked)
    assert (found.dropout, found.opacity_weight, found.resolution.coarsest) == (0.1, 0.3, 4.0)
    assert (found.density.gradient, found.density.split_gradient) == (1e-3, 5e-3)
    assert found.most_points == 77


def test_completed_points_are_as_many_as_asked_for_at_most():
    asked = replace(ASKED, completed=True, most_points=50, steps=10)
    found = planned(aerial_scene().for_training(), asked, Run(threads=1))
    assert found.start is not None
    assert 10 < len(found.start.points) <= 50


@pytest.mark.parametrize(
    ("budget", "completes"),
    [({"steps": LEAST}, True), ({"steps": LEAST - 1}, False), ({"seconds": 0.5}, False)],
)
def test_nothing_is_completed_where_too_few_steps_would_follow(budget, completes):
    scene = aerial_scene().for_training()
    wanted, _ = planned_completion(ASKED, FACTS, points=len(scene.points), moves=False)
    assert wanted
    found = plan_of(replace(ASKED, **budget))
    assert found.plan.base == ("stratosplat" if completes else "3dgs")
    (told,) = [one for one in found.plan.choices if one.component == "completed depths"]
    assert (f"and {LEAST} are needed" in told.because) == (not completes)
    assert found.plan.settings.sh_interval == (1000 if completes else 0)


@pytest.mark.parametrize(("steps", "base"), [(LEAST - 1, "3dgs"), (LEAST, "stratosplat")])
def test_photos_are_matched_once_whether_depths_are_completed_or_not(steps, base, monkeypatch):
    scene, asked = aerial_scene().for_training(), replace(ASKED, dense_cell=8.0, steps=steps)
    calls = []

    def matched(scene, *settings):  # these photos are too small to be matched
        calls.append(settings)
        return with_at_most(scene, 20)

    monkeypatch.setattr(initialise, "with_dense_points", matched)
    found = planned(scene, asked, Run(threads=1))
    assert (found.plan.base, len(calls)) == (base, 1)
    assert found.start is not None
    assert base == "stratosplat" or len(found.start.points) < len(scene.points)
    again = started(scene, found.plan.settings, Run(threads=1), base)  # as a continued run does
    assert torch.equal(found.start.points.positions, again.points.positions)


@pytest.mark.parametrize("steps", [LEAST, RESETS_FROM])
def test_opacities_are_reset_only_where_time_is_left_to_grow_back(steps):
    found = plan_of(replace(ASKED, steps=steps))
    assert (found.plan.settings.density.reset_interval > 0) == (steps >= RESETS_FROM)


@pytest.mark.parametrize(
    ("whole", "coarse", "told"),
    [(ENOUGH, 1.0, ""), (ENOUGH - 1, 2.0, "1/2 of the photos' size"), (60, 4.0, "from 1/4 of the photos' size to 1/2"),
     (1, 8.0, "from 1/8 of the photos' size to 1/2")],
)  # fmt: skip
def test_photos_are_made_smaller_until_enough_steps_fit(whole, coarse, told):
    facts = replace(FACTS, width=900, height=674)

    def steps(settings):
        return round(whole / settings.resolution.relative_pixels(100))

    start = completing(usual(ASKED, facts), ASKED)
    found, choices = sized(start, facts, steps)
    assert found.resolution.coarsest == coarse
    assert [one.value for one in choices] == ([told] if told else [])
    assert all(f"about {whole} steps would fit" in one.because for one in choices)
    assert (found == start) == (coarse == 1.0)


def test_a_given_size_of_the_photos_stands_in_the_plan():
    asked = replace(ASKED, completed=True, coarsest=2.0, steps=LEAST)
    found = planned(aerial_scene().for_training(), asked, Run(threads=1)).plan
    assert found.settings.resolution.coarsest == 2.0
    assert [one.component for one in found.choices].count("resolution") == 1


def test_small_photos_are_not_made_smaller():
    facts = replace(FACTS, width=120, height=100)
    start = completing(usual(ASKED, facts), ASKED)
    assert sized(start, facts, lambda _: 1) == (start, ())
