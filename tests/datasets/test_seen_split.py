"""The split that leaves the rim to training, on rows of cameras over a plane: overlaps are known by hand."""

from dataclasses import replace

import pytest

from helpers.colmap_scenes import Flight, write_scene
from helpers.flat_ground import PLANE, plane_points, view
from splatproof.base.errors import DataError, UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.seen_split import seen_split
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.protocol import Protocol

RULES = Protocol(name="p", source="test", hold=4, least_seen=0.99)


def row(*places: float) -> list:
    return [view(x, PLANE) for x in places]


def test_a_rim_view_is_left_to_training_and_the_next_seen_one_is_held_out():
    # the first camera stands apart; each other's ground is covered by the two beside it
    views = row(-9.0, -3.0, 0.0, 3.0, 6.0, 7.0, 8.0, 9.0)
    train, test = seen_split(views, plane_points(), RULES)
    # number 0 has ground to its left that nobody shows; what 1 shows, 0 and 2 show; 4 as usual
    assert test == (1, 4)
    assert sorted(train + test) == list(range(8))
    assert seen_split(views, plane_points(), replace(RULES, least_seen=0.01))[1] == (0, 4)


def test_two_that_see_each_other_are_not_both_held_out():
    # 0 and 1 stand at one place with nobody else near: each is seen by the other alone
    views = row(0.0, 0.0, 100.0, 100.0)
    _, test = seen_split(views, plane_points(), replace(RULES, hold=1))
    assert test == (0, 2)


def test_points_stand_in_where_depth_is_not_known():
    views = [view(x) for x in (-9.0, -3.0, 0.0, 3.0, 6.0, 7.0, 8.0, 9.0)]
    assert 0 not in seen_split(views, plane_points(), RULES)[1]


def test_the_other_rules_of_a_split_are_applied_then():
    views = row(*map(float, range(12)))
    train, test = seen_split(views, plane_points(), replace(RULES, train_views=3))
    assert len(train) == 3
    assert not set(train) & set(test)


def test_a_survey_of_which_nothing_is_seen_is_refused_with_the_best_share():
    with pytest.raises(DataError, match=r"at least 0\.99 of no view \(0\.\d+ of the best\)"):
        seen_split(row(0.0, 9.0, 18.0), plane_points(), RULES)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("least_seen = 1.5", "expected a share"),
        ('least_seen = 0.9\ntest_names = ["a"]', "leave test_names"),
        ("least_seen = 0.9\nhold = 0", "set hold above 0"),
        ('least_seen = 0.9\nhold_unit = "time"', "hold_unit to 'view'"),
    ],
)
def test_rules_that_do_not_go_together_are_refused(tmp_path, more, said):
    path = tmp_path / "mine.toml"
    path.write_text(f'source = "me"\n{more}\n')
    with pytest.raises(UsageError, match=said):
        load_protocol(path)


def test_a_scene_is_opened_with_that_split(tmp_path):
    folder = write_scene(tmp_path / "flight", Flight())
    usual = open_scene(folder, replace(RULES, least_seen=0.0))
    scene = open_scene(folder, RULES)
    assert usual.test == (0, 4)
    assert scene.test == seen_split(scene.views, scene.points, RULES)[1] != usual.test
    assert scene.facts["split_sha256"] != usual.facts["split_sha256"]
