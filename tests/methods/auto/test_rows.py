"""What a plan prints: each choice with its reason, and figures that were computed or measured."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from splatproof.methods.auto.bounds import file_mb, gaussian_bytes
from splatproof.methods.auto.candidates import unopposed
from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.measured import (
    CONTESTS,
    DROPPING,
    MOVING,
    NO_DROPOUT,
    QUICKER,
    SHRUNK,
    SPLIT,
    UNEXPOSED,
    UNLEARNT,
    Contest,
)
from splatproof.methods.auto.planner import AutoPlan, plan
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.auto.steps import training_seconds
from splatproof.methods.auto.usual import usual
from splatproof.methods.training.resolution import Resolution

DOCS = Path(__file__).parents[3] / "docs"
FACTS = SceneFacts(
    views=40, width=400, height=300, points=50_000, track=5.0, coverage=8.0, neighbours=10.0,
    angle=30.0, down=0.9, bare=0.3, detail=5.0, noise=1.0, exposure=0.01, moments=0, swept=False, moving=0.0,
    image_bytes=1,
)  # fmt: skip
SPEED = Speed(pixels=0.02, gaussian=3e-7)


def made(
    asked: AutoSettings | None = None, *, facts: SceneFacts = FACTS, seconds: float = 50.0
) -> AutoPlan:
    asked = asked or AutoSettings()
    return plan(asked, facts, usual(asked, facts), (), SPEED, seconds, 10_000.0)


def told(found: AutoPlan) -> dict[str, Choice]:
    return {one.component: one for one in found.choices}


def test_every_choice_has_a_reason_and_says_what_it_brings_or_that_nobody_measured():
    found = made()
    assert [one.component for one in found.choices] == [
        "exposure", "blocks", "points", "resolution", "density", "splitting", "Gaussians", "largest scale", "thickness", "harmonics",
        "opacity term", "views a step", "steps", "rates", "dropout", "anchors",
    ]  # fmt: skip
    assert all(one.because and one.expects for one in found.choices)
    assert told(found)["views a step"].value == "1"
    assert told(found)["density"].value == "by gradients, from a pull of 0.0004"


def test_seconds_are_computed_by_the_speed_that_was_measured():
    found = made()
    settings, steps = found.settings, found.settings.iterations

    def longer(**otherwise) -> float:
        other = training_seconds(replace(settings, **otherwise), FACTS, SPEED, steps)
        return other - training_seconds(settings, FACTS, SPEED, steps)

    rows = told(found)
    small = longer(resolution=Resolution())
    assert small > 1
    assert f" {small:.0f} s saved; {SHRUNK}" in rows["resolution"].expects
    fewer = longer(most_points=None)
    assert fewer > 1
    assert rows["points"].value == "30,000 of 50,000"
    assert rows["points"].expects == f"{fewer:.0f} s saved"
    low, high = 0.4 * found.seconds, 0.7 * found.seconds
    assert rows["density"].expects.startswith(f"{low:.0f} to {high:.0f} s less than mcmc takes; ")


def test_what_few_photos_leave_of_the_seconds_is_told():
    few = replace(FACTS, views=4)
    found = made(facts=few, seconds=500.0)
    spared = 500 - found.seconds
    assert spared > 100
    assert told(found)["steps"].expects == f"each photo 750 times, {spared:.0f} s not needed"


def test_megabytes_are_those_of_a_file():
    found = made(AutoSettings(megabytes=2.0))
    most, degree = found.settings.density.most, found.settings.sh_degree
    assert most is not None
    assert 1.99 < file_mb(most, degree, FACTS.views) <= 2.0
    rows = told(made())
    assert rows["Gaussians"].value == "at most 192,000"
    assert rows["Gaussians"].expects == f"{file_mb(192_000, 3, 40):.1f} MB of file at most"
    assert rows["Gaussians"].because.endswith("25 a Gaussian")
    more = 192_000 * (gaussian_bytes(3) - gaussian_bytes(0)) / 2**20
    assert rows["harmonics"].expects == f"236 bytes a Gaussian, {more:.1f} MB more than degree 0"
    assert rows["blocks"].expects.endswith(" % of the free memory")


def test_there_may_be_as_many_gaussians_as_training_starts_from():
    facts = replace(FACTS, views=1, points=9000)
    row = told(made(facts=facts))["Gaussians"]
    assert row.value == "at most 9,000"
    assert row.because.endswith("25 a Gaussian; training starts from more than these 4,800")
    assert row.expects == f"{file_mb(9000, 3, 1):.1f} MB of file at most"


@pytest.mark.parametrize(
    ("asked", "component"),
    [({"coarsest": 1.0}, "resolution"), ({"gradient": math.inf}, "density"), ({"exposure": "gain"}, "exposure"),
     ({"widest": 0.0}, "largest scale"), ({"thickest": 0.0}, "thickness"), ({"opacity_weight": 0.1}, "opacity term"), ({"dropout": 0.5}, "dropout"),
     ({"rates": 2.0}, "rates"), ({"split_gradient": 0.0}, "splitting"), ({"split_gradient": 1e-3}, "splitting")],
)  # fmt: skip
def test_of_what_is_given_nothing_is_promised(asked, component):
    row = told(made(AutoSettings(**asked)))[component]
    assert (row.because, row.expects) == ("given", NOT_MEASURED)


@pytest.mark.parametrize(
    ("spread", "because"),
    [(0.01, "photos differ by 1.0 % in brightness; gains are tried from 2 % on"),
     (math.nan, "too few shared points say whether photos differ in brightness"), (0.1, "usual; not probed")],
)  # fmt: skip
def test_exposures_that_nothing_competed_with_have_a_reason(spread, because):
    facts = replace(FACTS, exposure=spread)
    row = unopposed(AutoSettings(), usual(AutoSettings(), facts), facts)
    assert (row.value, row.because, row.expects) == ("off", because, str(UNEXPOSED))


@pytest.mark.parametrize(
    ("photos", "looks", "value", "expects"),
    [(24, 60, "0.2", str(DROPPING)), (25, 60, "off", str(UNLEARNT)), (24, 59, "off", NO_DROPOUT), (25, 59, "off", NO_DROPOUT)],
)  # fmt: skip
def test_dropout_promises_what_was_measured_where_photos_are_as_many_and_looked_at_as_often(
    photos, looks, value, expects
):
    found = made(AutoSettings(steps=photos * looks), facts=replace(FACTS, views=photos))
    row = told(found)["dropout"]
    assert (row.value, row.expects) == (value, expects)


def test_figures_are_a_range_over_scenes():
    two = {("a", "small"): -0.14, ("a", "large"): 0.31, ("b", "small"): 0.2}
    assert str(Contest(row="", gains=two)) == "-0.1 to +0.3 dB on 2 scenes (docs/auto.md)"
    assert str(Contest(row="", gains={("a", ""): -0.3, ("b", ""): -0.02})).startswith(
        "-0.3 to +0.0"
    )
    assert str(MOVING) == "+0.2 dB on street (docs/auto.md)"


@pytest.mark.parametrize("contest", CONTESTS, ids=lambda one: one.row)
def test_figures_are_those_of_the_committed_rows(contest):
    """Whoever runs the suite again finds here which figure of a plan has become another."""
    rows = json.loads((DOCS / "auto.json").read_text(encoding="utf-8"))
    for place, gain in contest.gains.items():
        own, other = (
            {row["seed"]: row["psnr"] for row in rows
             if (row["scene"], row["protocol"]) == place and row["row"] == name}
            for name in ("auto", contest.row)
        )  # fmt: skip
        paired = [own[seed] - other[seed] for seed in own if seed in other]
        assert sum(paired) / len(paired) == pytest.approx(gain, abs=0.0055)


def test_what_larger_steps_and_absolute_gradients_gain_is_in_the_committed_rows_of_suite_minute():
    rows = json.loads((DOCS / "minute.json").read_text(encoding="utf-8"))

    def gain(scene: str, name: str, other: str) -> float:
        own, its = (
            {r["seed"]: r["final"]["psnr"] for r in rows if (r["scene"], r["row"]) == (scene, row)}
            for row in (name, other)
        )
        paired = [own[seed] - its[seed] for seed in own if seed in its]
        return sum(paired) / len(paired)

    # larger steps came before absolute gradients, which seneca does without
    alike = {"seneca": "auto", "caliterra": "auto@signed-split"}
    gains = {s: gain(s, row, "auto@release-rates") for s, row in alike.items()}
    told = ", ".join(f"{gained:+.1f} dB on {s}" for s, gained in gains.items())
    assert f"{told} (docs/minute.md)" == QUICKER
    split = gain("caliterra", "auto", "auto@signed-split")
    assert f"{split:+.1f} dB on caliterra (docs/minute.md)" == SPLIT
