"""The planner: budgets hold, what is fixed stays, and candidates win by enough or not at all."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatproof.base.errors import UsageError
from splatproof.methods.auto.bounds import bounded, training_mb
from splatproof.methods.auto.candidates import Candidate, candidates, compete
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.planner import plan
from splatproof.methods.auto.probe import better
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.auto.steps import most_steps, training_seconds
from splatproof.methods.auto.usual import (
    DROPOUT_FROM,
    MANY_PHOTOS,
    ONE_LIGHT,
    PACE,
    QUICKER,
    SETTLE,
    SPLITTING,
    coarsest,
    quicker,
    usual,
)
from splatproof.methods.training.schedules import Rates

FACTS = SceneFacts(
    views=40, width=400, height=300, points=10_000, track=5.0, coverage=8.0, neighbours=10.0,
    angle=30.0, down=0.9, bare=0.3, detail=5.0, noise=1.0, exposure=0.2, moments=0, swept=False, moving=0.0,
    image_bytes=1,
)  # fmt: skip
FEW = replace(FACTS, views=MANY_PHOTOS - 1)
"""The same scene in so few photos that they can be learnt by heart."""
SPEED = Speed(pixels=0.02, gaussian=3e-7)
SPEEDS = st.builds(Speed, pixels=st.floats(1e-4, 0.1), gaussian=st.floats(1e-9, 1e-6))


def planned(
    asked: AutoSettings, *, speed: Speed = SPEED, seconds: float = 50.0, facts: SceneFacts = FACTS
):
    return plan(asked, facts, usual(asked, facts), (), speed, seconds)


@given(speed=SPEEDS, seconds=st.floats(5, 600))
def test_training_fits_into_the_seconds(speed, seconds):
    found = planned(AutoSettings(), speed=speed, seconds=seconds)
    steps = found.settings.iterations
    assert found.seconds <= seconds or steps == 100
    assert (
        steps == most_steps(found.settings, FACTS.views)[0]
        or training_seconds(found.settings, FACTS, speed, steps + 1) > seconds
    )


@given(seconds=st.floats(5, 300), more=st.floats(1, 4))
def test_more_seconds_never_mean_fewer_steps(seconds, more):
    short, long = (planned(AutoSettings(), seconds=s) for s in (seconds, seconds * more))
    assert long.settings.iterations >= short.settings.iterations


@pytest.mark.parametrize(("views", "steps"), [(1, 3000), (12, 3000), (13, 3250), (1000, 30_000)])
def test_few_photos_have_steps_enough_and_many_are_not_learnt_by_heart(views, steps):
    assert most_steps(usual(AutoSettings(), FACTS), views)[0] == steps


def test_seconds_that_are_spent_are_none():
    (steps,) = [
        choice
        for choice in planned(AutoSettings(), seconds=-8.2).choices
        if choice.component == "steps"
    ]
    assert steps.because.startswith("0 s are left; ")


def test_a_file_has_a_bound():
    found = planned(AutoSettings(megabytes=2.0))
    assert found.settings.density.most == (2 * 2**20 - 4096 - 64 * 40) // (4 * 59)
    assert any("2 MB" in choice.because for choice in found.choices)


@pytest.mark.parametrize(("views", "kept"), [(10, 10), (90, 90), (300, 100)])
def test_photos_in_memory_leave_less_for_gaussians(views, kept):
    one = 2000 * 1500 * 12
    facts = replace(FACTS, views=views, width=2000, height=1500, image_bytes=views * one)
    none = replace(facts, image_bytes=0)
    taken = training_mb(facts, 5, 3, 100 * one) - training_mb(none, 5, 3, 100 * one)
    assert taken == pytest.approx(kept * one / 2**20)
    asked = AutoSettings()
    found = [
        plan(asked, facts, usual(asked, facts), (), SPEED, 50.0, 9000.0, "3dgs", count * one)
        for count in (0, 100)
    ]
    without, much = (one.settings.density.most or 0 for one in found)
    assert without >= much
    assert (without > much) == (views > 10)
    assert training_mb(facts, much, 3, 100 * one) <= 0.8 * 9000.0
    room = [
        bounded(asked, usual(asked, facts), facts, 9000.0, count * one).most_points or 0
        for count in (0, 100)
    ]
    assert room[0] >= room[1]


@given(free=st.floats(100, 1e5), views=st.integers(1, 3000))
def test_training_fits_into_memory_or_is_as_small_as_it_gets(free, views):
    facts = replace(FACTS, views=views, width=2000, height=1500, image_bytes=views * 36_000_000)
    asked = AutoSettings()
    found = plan(asked, facts, usual(asked, facts), (), SPEED, 50.0, free)
    most = found.settings.density.most
    assert most is not None
    assert training_mb(facts, most, 3) <= 0.8 * free or most == 1000
    alone = plan(asked, facts, usual(asked, facts), (), SPEED, 50.0).settings.density.most
    assert alone is not None
    (told,) = (choice for choice in found.choices if choice.component == "blocks")
    assert ("fewer Gaussians" in told.value) == (most < alone)
    assert ("odbp+stitch" in told.because) == (most < alone)


@pytest.mark.parametrize(
    ("megabytes", "degree", "points"),
    [(0.0, 3, 30_000), (2.5, 3, 10_000), (2.0, 2, 10_000), (1.0, 1, 10_000), (0.6, 0, 10_000), (0.3, 0, 5_495)],
)  # fmt: skip
def test_a_small_file_has_rather_more_gaussians_than_more_harmonics(megabytes, degree, points):
    asked = AutoSettings(megabytes=megabytes)
    found = bounded(asked, usual(asked, FACTS), FACTS, math.inf)
    assert found.sh_degree == degree
    assert found.most_points is not None
    assert (found.most_points >= FACTS.points) == (points >= FACTS.points)
    given = replace(asked, sh_degree=2)
    assert bounded(given, usual(given, FACTS), FACTS, math.inf).sh_degree == 2
    (told,) = (
        one for one in plan(asked, FACTS, found, (), SPEED, 50.0).choices if one.component == "harmonics"
    )  # fmt: skip
    assert told.value == f"degree {degree}"
    assert ("of a higher one" in told.because) == (degree < 3)


def test_a_start_has_no_more_points_than_there_may_be_gaussians():
    asked = AutoSettings(megabytes=0.3)
    found = bounded(asked, usual(asked, FACTS), FACTS, math.inf)
    most = plan(asked, FACTS, found, (), SPEED, 50.0).settings.density.most
    assert found.most_points == most == int((0.3 * 2**20 - 4096 - 64 * 40) / (4 * 14))
    memory = bounded(AutoSettings(), usual(AutoSettings(), FACTS), FACTS, 560.0)
    assert memory.most_points is not None
    assert memory.most_points < 30_000
    assert (
        bounded(AutoSettings(), usual(AutoSettings(), FACTS), FACTS, math.inf).most_points == 30_000
    )


def test_a_quality_asked_for_stands_in_the_plan():
    choices = {choice.component: choice for choice in planned(AutoSettings(db=25.0)).choices}
    assert choices["end"].value == "at 25 dB, or with the last step"
    assert "end" not in {choice.component for choice in planned(AutoSettings()).choices}


def test_what_is_fixed_is_neither_planned_nor_tried():
    asked = AutoSettings(
        coarsest=1.0, opacity_weight=0.5, dropout=0.1, exposure="affine", steps=123,
        sh_degree=1, gradient=1e-3, dense_cell=4.0,
    )  # fmt: skip
    found = planned(asked).settings
    assert (found.opacity_weight, found.dropout, found.exposure) == (0.5, 0.1, "affine")
    assert (found.iterations, found.sh_degree, found.density.gradient) == (123, 1, 1e-3)
    assert (found.resolution.coarsest, found.dense_cell) == (1.0, 4.0)
    assert candidates(asked, FACTS) == []


@pytest.mark.parametrize(
    ("name", "component", "usual", "why"),
    [("widest", "largest scale", 0.5, "veil a photo"), ("thickest", "thickness", 0.03, "as fog")],
)
def test_bounds_on_shape_stand_in_the_plan(name, component, usual, why):
    for asked, share, because in ((None, usual, why), (0.0, 0.0, "given"), (2.0, 2.0, "given")):
        given: dict[str, Any] = {name: asked}
        found = planned(replace(AutoSettings(), **given))
        assert getattr(found.settings, name) == share
        (told,) = (one for one in found.choices if one.component == component)
        assert because in told.because
        held = f"{share:g} of the distance to the nearest camera"
        assert (held in told.value) == bool(share)


def test_the_pace_stands_in_the_plan_and_needs_a_cap_that_only_the_plan_knows():
    for pace in ("free", "even"):
        asked = AutoSettings(pace=pace)
        assert usual(asked, FACTS).density.pace == "free"
        found = planned(asked)
        assert found.settings.density.pace == pace
        (told,) = (one for one in found.choices if one.component == "Gaussians")
        assert told.value.endswith(", at an even pace") == (pace == "even")
    assert planned(AutoSettings()).settings.density.pace == PACE


@pytest.mark.parametrize(("looks", "dropout"), [(59, 0.0), (60, 0.2), (250, 0.2)])
def test_dropout_is_for_few_photos_that_are_looked_at_often(looks, dropout):
    found = planned(AutoSettings(steps=looks * FEW.views), facts=FEW)
    assert found.settings.dropout == dropout
    (told,) = (one for one in found.choices if one.component == "dropout")
    assert told.value == (f"{dropout:g}" if dropout else "off")
    assert "by heart" in told.because


def test_dropout_that_is_given_stays_and_completed_depths_keep_their_own():
    asked = AutoSettings(steps=40, dropout=0.3)
    found = planned(asked)
    assert found.settings.dropout == 0.3
    assert [one.because for one in found.choices if one.component == "dropout"] == ["given"]
    own = replace(usual(AutoSettings(), FACTS), dropout=0.5)
    few = plan(AutoSettings(steps=40), FACTS, own, (), SPEED, 50.0, base="stratosplat")
    assert few.settings.dropout == 0.5
    assert "dropout" not in {one.component for one in few.choices}


@pytest.mark.parametrize(("looks", "factor"), [(59, QUICKER), (60, 1.0), (250, 1.0)])
def test_few_photos_are_learnt_by_larger_steps_where_they_are_looked_at_seldom(looks, factor):
    """All but positions and opacities, whose steps no trial made larger; larger steps end small."""
    asked = AutoSettings(steps=looks * FEW.views)
    found, release = planned(asked, facts=FEW), Rates()
    rates = found.settings.rates
    for name in ("sh_dc", "sh_rest", "log_scales", "quaternions"):
        assert getattr(rates, name) == pytest.approx(factor * getattr(release, name))
    for name in ("means", "means_final", "opacity_logits"):
        assert getattr(rates, name) == getattr(release, name)
    assert rates.settle == (1.0 if factor == 1 else SETTLE)
    (told,) = (one for one in found.choices if one.component == "rates")
    assert told.value.startswith("the release's" if factor == 1 else f"{factor:g} times")
    assert ("small steps do not get as far" in told.because) == (factor != 1)


@pytest.mark.parametrize(("photos", "many"), [(MANY_PHOTOS - 1, False), (MANY_PHOTOS, True)])
@pytest.mark.parametrize("looks", [DROPOUT_FROM, 250])
def test_many_photos_are_not_learnt_by_heart_however_often_each_is_looked_at(looks, photos, many):
    facts = replace(FACTS, views=photos, exposure=0.01)
    asked = AutoSettings(steps=looks * photos)
    found = plan(asked, facts, usual(asked, facts), (), SPEED, 50.0).settings
    seldom = replace(asked, steps=10 * photos)
    soon = plan(seldom, facts, usual(seldom, facts), (), SPEED, 50.0).settings
    assert (replace(found, iterations=soon.iterations) == soon) == many
    assert bool(found.dropout) != many


def test_rates_that_are_given_stay_and_only_gaussians_that_stand_still_have_others():
    for looks in (40, 400):
        found = planned(AutoSettings(steps=looks * FACTS.views, rates=2.0))
        assert found.settings.rates == quicker(2.0)
        assert [one.because for one in found.choices if one.component == "rates"] == ["given"]
    for base in ("pvg", "stratosplat"):
        asked = AutoSettings(steps=40)
        few = plan(asked, FACTS, usual(asked, FACTS), (), SPEED, 50.0, base=base)
        assert few.settings.rates == Rates()


def test_exposures_compete_where_photos_differ():
    assert [one.setting for one in candidates(AutoSettings(), FACTS)] == ["exposure"]
    for spread in (0.001, math.nan):
        assert candidates(AutoSettings(), replace(FACTS, exposure=spread)) == []


@given(views=st.integers(1, 500), seconds=st.floats(5, 1e5))
def test_no_photo_is_learnt_by_heart(views, seconds):
    facts = replace(FACTS, views=views)
    found = plan(AutoSettings(), facts, usual(AutoSettings(), facts), (), SPEED, seconds)
    most = max(3000, 250 * views)
    assert found.settings.iterations <= most
    (told,) = (choice for choice in found.choices if choice.component == "steps")
    by_heart = "learnt by heart" in told.because
    assert not by_heart or found.settings.iterations == min(most, 30_000)


@given(width=st.integers(16, 8000), height=st.integers(16, 8000))
def test_photos_are_not_shrunk_to_nothing(width, height):
    factor = coarsest(width, height)
    assert 1 <= factor <= 8
    assert factor == 1 or min(width, height) / factor >= 80


def test_candidates_compete_one_after_the_other():
    """The second is tried beside the first, which won; what loses leaves the settings alone."""
    start = usual(AutoSettings(), FACTS)
    tried = [
        Candidate(setting="opacity_weight", value=0.0, because=""),
        Candidate(setting="dropout", value=0.4, because=""),
        Candidate(setting="dropout", value=0.0, because=""),
    ]

    def score(settings, attempt):
        return tuple(
            20 + (settings.opacity_weight == 0) - (settings.dropout == 0.4)
            + 2.0 * (settings.dropout == 0 and settings.opacity_weight == 0) + 0.01 * view
            for view in range(4)
        )  # fmt: skip

    won, choices = compete(start, tried, score, better, lambda trainings: True)
    assert (won.opacity_weight, won.dropout) == (0.0, 0.0)
    assert [choice.component for choice in choices] == ["opacity weight", "dropout"]
    assert "-1.00 dB on 4 held-out training views" in choices[1].because
    same, nothing = compete(start, tried, score, better, lambda trainings: False)
    assert same == start
    assert [choice.because for choice in nothing] == ["usual; no time to probe"] * 2


@pytest.mark.parametrize(
    ("gains", "most", "wins", "told"),
    [
        ((0.5, 0.6), 9, True, "+0.55 dB on 4 held-out training views, twice"),
        ((0.5, -0.4), 9, False, "+0.05 dB on 4 held-out training views, twice"),
        ((0.5, -0.4), 3, True, "+0.50 dB on 4 held-out training views"),  # no time for two more
        ((0.1, 9.0), 9, False, "+0.10 dB on 4 held-out training views"),
    ],
)
def test_what_wins_once_has_to_win_by_other_draws_as_well(gains, most, wins, told):
    """A gain that draws alone made is none by others; what loses at once is not tried again."""
    start = usual(AutoSettings(), FACTS)
    tried = [Candidate(setting="exposure", value="gain", because="")]
    trainings = []

    def score(settings, attempt):
        trainings.append((settings.exposure, attempt))
        return (20 + attempt + gains[attempt] * (settings.exposure == "gain"),) * 4

    def left(count):
        return len(trainings) + count <= most

    won, (choice,) = compete(start, tried, score, better, left)
    assert won.exposure == ("gain" if wins else "off")
    assert choice.because == f"probe: gain: {told}"
    assert len(set(trainings)) == len(trainings) == (4 if "twice" in told else 2)


@pytest.mark.parametrize(
    ("gains", "wins"),
    [((0.5, 0.5, 0.5), True), ((0.2, 0.2, 0.2), False), ((5.0, -3.0, 0.1), False), ((1.0,), True)],
)
def test_a_gain_counts_where_it_is_large_and_sure(gains, wins):
    assert better([20 + gain for gain in gains], [20.0] * len(gains), 0.3) is wins


@pytest.mark.parametrize(
    "values",
    [
        {"seconds": 0.0},
        {"probe_share": 0.9},
        {"coarsest": 0.5},
        {"dropout": 2.0},
        {"rates": -1.0},
        {"megabytes": -1.0},
        {"db": 100.0},
    ],
)
def test_impossible_wishes_are_refused(values):
    with pytest.raises(UsageError, match=next(iter(values))):
        AutoSettings(**values)


def test_what_larger_steps_learn_is_narrower_on_points():
    """Few looks have the larger steps; rates that are given say whether it needs the bound, which can be given too."""
    for looks, asked, share in (
        (59, {}, 0.2), (60, {}, 0.0), (59, {"rates": 1.0}, 0.0), (59, {"rates": 2.0}, 0.2),
        (59, {"widest_at_points": 0.0}, 0.0), (59, {"widest_at_points": 0.4}, 0.4),
        (60, {"widest_at_points": 0.4}, 0.4),
    ):  # fmt: skip
        given: dict[str, Any] = asked
        found = planned(replace(AutoSettings(steps=looks * FEW.views), **given), facts=FEW)
        assert found.settings.widest_at_points == share
        (told,) = (one for one in found.choices if one.component == "largest scale")
        assert ("on start points" in told.value) == ("fog" in told.because) == bool(share)


@pytest.mark.parametrize(
    ("asked", "exposure", "pull", "split"),
    [({}, 0.01, 4e-4, SPLITTING * 4e-4), ({}, ONE_LIGHT, 4e-4, SPLITTING * 4e-4), ({}, 1.01 * ONE_LIGHT, 4e-4, 0.0), ({}, math.nan, 4e-4, 0.0),
     ({"gradient": 1e-3}, 0.01, 1e-3, SPLITTING * 1e-3), ({"split_gradient": 0.0}, 0.01, 4e-4, 0.0),
     ({"gradient": 1e-3, "split_gradient": 5e-3}, 0.2, 1e-3, 5e-3), ({"gradient": math.inf}, 0.01, math.inf, 0.0)],
)  # fmt: skip
@pytest.mark.parametrize("looks", [10, DROPOUT_FROM])
def test_large_gaussians_are_split_by_absolute_gradients_where_photos_of_one_light_are_looked_at_seldom(
    asked, exposure, pull, split, looks
):
    asked = AutoSettings(**asked, steps=looks * FEW.views)
    facts = replace(FEW, exposure=exposure)
    found = plan(asked, facts, usual(asked, facts), (), SPEED, 50.0).settings.density
    assert found.gradient == pull
    assert found.split_gradient == (split if looks < DROPOUT_FROM else asked.split_gradient or 0.0)
