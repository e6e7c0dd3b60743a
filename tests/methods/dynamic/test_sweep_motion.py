"""How fast things move: groups of returns that are found again in the next sweep."""

import numpy as np
import pytest
import torch

from splatproof.methods.dynamic.sweep_motion import in_motion, motion, things
from splatproof.methods.dynamic.sweep_points import TimedPoints, joined

UP = np.array([0.0, 0.0, 1.0])


def box(seed: int = 0, count: int = 60) -> np.ndarray:
    """Returns on a thing of 2 x 1 x 1, as irregular as a car."""
    return np.random.default_rng(seed).uniform(0, 1, (count, 3)) * [2, 1, 1]


def at(seconds: float, places: np.ndarray, *, moved: bool = True) -> TimedPoints:
    count = len(places)
    return TimedPoints(
        positions=torch.from_numpy(places), colours=torch.zeros(count, 3).byte(),
        seconds=torch.full((count,), seconds).double(), moved=torch.full((count,), moved),
        velocities=torch.zeros(count, 3),
    )  # fmt: skip


def test_returns_that_lie_together_are_one_thing():
    both = np.concatenate([box(), box(1) + [20, 0, 0]])
    groups = things(both)
    assert len(set(groups[:60].tolist())) == len(set(groups[60:].tolist())) == 1
    assert groups[0] != groups[60]
    assert things(np.zeros((0, 3))).tolist() == []
    assert things(np.zeros((1, 3))).tolist() == [0]


@pytest.mark.parametrize("shift", [(0.9, 0.0, 0.0), (-2.2, 0.1, 0.0), (0.0, 0.15, -0.05)])
def test_a_thing_is_found_where_it_went_among_others(shift):
    thing = box()
    others = np.concatenate([thing + shift, box(5) + [0, 8, 0]])
    left, found = motion(thing, others, UP)
    assert left < 1e-6
    np.testing.assert_allclose(found, shift, atol=1e-6)


def test_it_is_found_though_other_parts_of_it_are_hit():
    thing, again = box(count=400), box(9, count=400) + [0.9, 0.3, 0.0]
    left, found = motion(thing, again, UP)
    assert left < 0.7
    np.testing.assert_allclose(found, [0.9, 0.3, 0.0], atol=0.15)  # returns are 0.15 apart


def test_what_is_gone_is_not_found():
    left, _ = motion(box(), box() + [50, 0, 0], UP)
    assert left == float("inf")


def test_things_have_their_own_velocities_and_what_stands_still_is_not_in_motion():
    places = {0.1: 0.0, 0.2: 0.1, 0.4: 0.3}
    parts = []
    for seconds, gone in places.items():
        parts.append(at(seconds, box(1) + [9 * gone, 0, 0]))
        parts.append(at(seconds, box(2) * 0.3 + [30, -1.5 * gone, 0]))
        parts.append(at(seconds, box(3) + [0, 40, 0]))  # twigs: looked through, but they stay
        parts.append(at(seconds, box(4) + [0, 80 + 9 * gone, 0], moved=False))
    found = in_motion(joined(parts), torch.from_numpy(UP))
    for which, wanted in ((0, (9.0, 0, 0)), (1, (0, -1.5, 0)), (2, (0, 0, 0)), (3, (0, 0, 0))):
        own = torch.cat([torch.arange(60) + 60 * (which + 4 * k) for k in range(3)])
        want = torch.tensor([wanted]).expand(180, 3).float()
        torch.testing.assert_close(found.velocities[own], want, atol=1e-3, rtol=0)
        assert bool((found.moved[own] == (which < 2)).all())


def test_a_single_moment_and_no_points_have_no_motion():
    assert not in_motion(at(0.1, box()), torch.from_numpy(UP)).moved.any()
    assert len(in_motion(joined([]), torch.from_numpy(UP))) == 0


def post(seed: int) -> np.ndarray:
    """Returns on a post, 4 high and thin, at other heights each time."""
    rng = np.random.default_rng(seed)
    return np.stack([*rng.normal(0, 0.02, (2, 20)), rng.uniform(0, 4, 20)], axis=1)


def test_a_post_that_other_returns_lie_on_stands_still():
    # as returns lie on it that no other moment has, it seems to slide along itself
    parts = [at(0.1 * k, post(k) + [0, 9, 0]) for k in range(6)]
    assert not in_motion(joined(parts), torch.from_numpy(UP)).moved.any()


def test_nothing_is_found_to_rise():
    left, shift = motion(box(count=200), box(count=200) + [0.1, 0, 0.8], UP)
    assert abs(shift[2]) <= np.hypot(*shift[:2]) + 0.2  # returns are 0.2 apart
    sideways = np.array([1.0, 0.0, 0.0])
    _, found = motion(box(count=200), box(count=200) + [0.1, 0, 0.8], sideways)
    np.testing.assert_allclose(found, [0.1, 0, 0.8], atol=1e-6)
    assert left > 0.3


def test_a_thing_of_many_returns_is_found_among_few_of_them():
    thing, again = box(count=6000), box(9, count=6000) + [0.9, 0.3, 0.0]
    left, found = motion(thing, again, UP)
    assert left < 0.7
    np.testing.assert_allclose(found, [0.9, 0.3, 0.0], atol=0.1)  # 256 of them are 0.2 apart


def test_beams_that_hit_a_thing_elsewhere_are_no_motion_of_it():
    rows = np.stack(np.meshgrid([0.0, 0.1], [9.0], np.arange(8) * 0.2), axis=-1).reshape(-1, 3)
    parts = [at(0.1 * k, rows + [0, 0.06 * (k % 2), 0]) for k in range(6)]  # spacing: 0.2
    assert not in_motion(joined(parts), torch.from_numpy(UP)).moved.any()


def test_what_is_part_of_something_larger_is_not_found_again_in_whole():
    side = np.arange(-3, 3, 0.1)
    x, z = np.meshgrid(side, side)
    wall = np.stack([x.ravel(), np.full(x.size, 0.5), z.ravel()], axis=1)
    thing = wall[(np.abs(wall[:, [0, 2]]) < 0.5).all(axis=1)] - [0, 0.5, 0]
    left, shift = motion(thing, wall, UP)
    assert shift[1] == pytest.approx(0.5)
    assert left > 0.2  # of the wall nearby, most is not the thing
