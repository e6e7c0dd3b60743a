"""How fast things move: groups of returns that are found again in the next sweep."""

import numpy as np
import pytest
import torch

from splatproof.methods.dynamic.sweep_motion import in_motion, motion, things
from splatproof.methods.dynamic.sweep_points import TimedPoints, joined


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
    left, found = motion(thing, others)
    assert left < 1e-6
    np.testing.assert_allclose(found, shift, atol=1e-6)


def test_it_is_found_though_other_parts_of_it_are_hit():
    thing, again = box(count=400), box(9, count=400) + [0.9, 0.3, 0.0]
    left, found = motion(thing, again)
    assert left < 0.7
    np.testing.assert_allclose(found, [0.9, 0.3, 0.0], atol=0.15)  # returns are 0.15 apart


def test_what_is_gone_is_not_found():
    left, _ = motion(box(), box() + [50, 0, 0])
    assert left == float("inf")


def test_things_have_their_own_velocities_and_what_stands_still_is_not_in_motion():
    places = {0.1: 0.0, 0.2: 0.1, 0.4: 0.3}
    parts = []
    for seconds, gone in places.items():
        parts.append(at(seconds, box(1) + [9 * gone, 0, 0]))
        parts.append(at(seconds, box(2) * 0.3 + [30, -1.5 * gone, 0]))
        parts.append(at(seconds, box(3) + [0, 40, 0]))  # twigs: looked through, but they stay
        parts.append(at(seconds, box(4) + [0, 80 + 9 * gone, 0], moved=False))
    found = in_motion(joined(parts))
    for which, wanted in ((0, (9.0, 0, 0)), (1, (0, -1.5, 0)), (2, (0, 0, 0)), (3, (0, 0, 0))):
        own = torch.cat([torch.arange(60) + 60 * (which + 4 * k) for k in range(3)])
        want = torch.tensor([wanted]).expand(180, 3).float()
        torch.testing.assert_close(found.velocities[own], want, atol=1e-3, rtol=0)
        assert bool((found.moved[own] == (which < 2)).all())


def test_a_single_moment_and_no_points_have_no_motion():
    assert not in_motion(at(0.1, box())).moved.any()
    assert len(in_motion(joined([]))) == 0
