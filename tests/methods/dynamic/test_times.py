"""Model time: frames of 0.02 around the middle of a drive, and views that cannot say when they are."""

from dataclasses import replace

import pytest

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.dynamic.times import Clock, clock_of
from splatproof.reference.types.scene import Scene


def at(*seconds: float | None) -> Scene:
    scene = tiny_scene(views=len(seconds))
    views = (replace(view, time=time) for view, time in zip(scene.views, seconds, strict=True))
    return replace(scene, views=tuple(views))


def test_a_frame_is_two_hundredths_and_the_middle_is_zero():
    scene = at(0.0, 0.1, 0.2, 0.3, 0.4, 0.4)
    clock = clock_of(scene)
    assert [clock.of(view) for view in scene.views] == pytest.approx(
        [-0.04, -0.02, 0.0, 0.02, 0.04, 0.04]
    )
    assert clock.duration == pytest.approx(0.08)


def test_a_missing_frame_is_a_longer_gap_not_another_clock():
    whole, part = at(0.0, 0.1, 0.2, 0.3, 0.4), at(0.0, 0.1, 0.3, 0.4)
    assert clock_of(part).second == pytest.approx(clock_of(whole).second)
    assert clock_of(part).second == pytest.approx(0.2)


def test_cameras_triggered_one_after_the_other_are_of_one_frame():
    scene = at(0.0, 0.03, 0.06, 0.1, 0.13, 0.16, 0.2, 0.23, 0.26)
    assert clock_of(scene).second == pytest.approx(0.02 / 0.03)  # one camera, as far as it says
    names = ("left", "front", "right") * 3
    views = (replace(view, sensor=name) for view, name in zip(scene.views, names, strict=True))
    clock = clock_of(replace(scene, views=tuple(views)))
    assert clock.second == pytest.approx(0.2)
    assert clock.duration == pytest.approx(0.2 * 0.26)
    once = (replace(view, sensor=view.name) for view in at(0.0, 0.1, 0.2).views)
    assert clock_of(replace(scene, views=tuple(once))).second == pytest.approx(0.2)


def test_one_moment_alone_is_at_zero_and_lasts_a_frame():
    clock = clock_of(at(3.0, 3.0))
    assert clock.at(3.0) == 0
    assert clock.duration == 0.02
    assert clock.at(3.1) == pytest.approx(0.02)


def test_views_without_time_are_refused_in_one_line():
    with pytest.raises(DataError, match=r"scene 'tiny': view '1.png' has no time.*static method"):
        clock_of(at(0.0, None, 0.2))
    clock = clock_of(at(0.0, 0.1))
    with pytest.raises(UsageError, match=r"view '0.png': has no time"):
        clock.of(tiny_scene().views[0])


def test_it_comes_back_from_what_is_stored():
    clock = clock_of(at(0.0, 0.1, 0.3))
    assert Clock.read(clock.facts()) == clock
    with pytest.raises(KeyError):
        Clock.read({"middle": 0.0, "second": 1.0})
