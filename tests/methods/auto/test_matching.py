"""Whether photos are matched: where points were found in few photos, few points are there, and there is time."""

import math
from dataclasses import replace

import pytest

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.auto import matching
from splatproof.methods.auto.facts import SceneFacts, facts_of
from splatproof.methods.auto.matching import CELL, PARTNERS, planned_matching
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.run import Run
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene

ASKED = AutoSettings(seconds=60.0)
ROOMY = 10**6


@pytest.fixture(scope="module")
def yard() -> Scene:
    return open_scene("courtyard", load_protocol("quick")).for_training()


@pytest.fixture(scope="module")
def facts(yard: Scene) -> SceneFacts:
    """Its own, but for points that were found in few photos."""
    return replace(facts_of(yard), track=3.0)


@pytest.fixture
def pair_takes(monkeypatch: pytest.MonkeyPatch):
    def planted(seconds: float) -> None:
        monkeypatch.setattr(matching, "_seconds", lambda *_: seconds)

    return planted


def test_points_of_few_photos_are_joined_by_matched_ones(yard, facts, pair_takes):
    pair_takes(1e-3)
    found = planned_matching(yard, ASKED, facts, ROOMY, Run())
    assert (found.cell, found.partners) == (CELL, PARTNERS[0])
    assert "3.0 photos only" in found.choice.because
    assert 0 < found.seconds < 1


def test_a_pair_is_timed(yard, facts):
    patient = replace(ASKED, seconds=1e6)  # a busy machine's pairs take their time
    assert planned_matching(yard, patient, facts, ROOMY, Run()).seconds > 0


@pytest.mark.parametrize("track", [5.0, 9.0, math.nan])
def test_points_of_many_photos_or_of_none_known_are_enough(yard, facts, track, pair_takes):
    pair_takes(math.nan)  # nobody looks
    found = planned_matching(yard, ASKED, replace(facts, track=track), ROOMY, Run())
    assert (found.cell, found.seconds) == (0.0, 0.0)


def test_where_points_would_be_merged_none_are_matched(yard, facts, pair_takes):
    pair_takes(math.nan)
    found = planned_matching(yard, ASKED, facts, facts.points, Run())
    assert found.cell == 0.0
    assert "enough to start from" in found.choice.because


def test_fewer_partners_and_then_none_where_time_is_short(yard, facts, pair_takes):
    pair_takes(1.0)
    whole = planned_matching(yard, replace(ASKED, dense_cell=4.0), facts, ROOMY, Run()).seconds
    little = replace(ASKED, seconds=0.99 * whole / matching.SHARE)
    assert planned_matching(yard, little, facts, ROOMY, Run()).partners == PARTNERS[1]
    least = replace(ASKED, seconds=0.1 * whole / matching.SHARE)
    found = planned_matching(yard, least, facts, ROOMY, Run())
    assert found.cell == 0.0
    assert "pairs of photos would take" in found.choice.because


def test_what_is_given_is_done(yard, facts, pair_takes):
    pair_takes(100.0)
    long = replace(facts, track=9.0)
    found = planned_matching(yard, replace(ASKED, dense_cell=6.0), long, facts.points, Run())
    assert (found.cell, found.choice.because) == (6.0, "given")
    assert found.seconds > 100
    none = planned_matching(yard, replace(ASKED, dense_cell=0.0), facts, ROOMY, Run())
    assert (none.cell, none.choice.because) == (0.0, "given")


def test_views_without_a_useful_angle_are_not_matched(yard, facts):
    alone = replace(yard, train=yard.train[:1])
    found = planned_matching(alone, ASKED, facts, ROOMY, Run())
    assert found.cell == 0.0
    assert "no two photos" in found.choice.because
