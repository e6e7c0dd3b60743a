"""Some of many: as many as are asked for, from the whole of their order."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import tiny_scene
from splatproof.methods.auto import speed
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.spreading import evenly
from splatproof.methods.auto.usual import usual_for
from splatproof.methods.contracts.run import Run


@given(count=st.integers(0, 200), most=st.integers(1, 50))
def test_some_are_spread_from_end_to_end(count, most):
    found = evenly(range(count), most)
    assert len(found) == min(count, most)
    assert list(found) == sorted(set(found))
    if count > most:
        steps = [found[0] + 0.5, *(b - a for a, b in pairwise(found)), count - found[-1] - 0.5]
        assert max(steps) <= count / most + 1


@pytest.mark.parametrize(("count", "seen"), [(2, (1, 2)), (5, (1, 3, 5)), (9, (2, 5, 8))])
def test_speed_is_measured_on_photos_of_the_whole_flight(monkeypatch, count, seen):
    trained = []
    monkeypatch.setattr(speed, "_step", lambda scene, *_: trained.append(scene.train) or (1.0, 10))
    scene = tiny_scene(views=count + 1)
    speed.measure(scene, usual_for(AutoSettings(), 24, 18), Run())
    assert trained == [seen, seen]
