"""Large photos: halved until enough steps fit, and no more of them than can be read."""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.aerial_scene import aerial_scene
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.datasets.truth_image import Truth
from splatproof.methods.auto import photos
from splatproof.methods.auto.fit import PLAN, fit
from splatproof.methods.auto.photos import (
    ENOUGH,
    Photos,
    middle_photo,
    planned_photos,
    reading_threads,
    size_factor,
    step_seconds,
    working,
)
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS, ExplicitModel

PIXELS = 24 * 18
SPEED = Speed(pixels=0.01, gaussian=3e-7)
ASKED = AutoSettings(seconds=20.0, probe_share=0.0)
RUN = Run(threads=1)


class Killed(Exception):
    """Stands for a kill between two steps."""


@pytest.fixture
def large(monkeypatch):
    """Photos of 24 x 18 pixels are large; a step of one takes ten seconds, of a quarter of it two and a half."""
    monkeypatch.setattr(photos, "LARGE", PIXELS - 1)
    monkeypatch.setattr(photos, "SHORT_SIDE", 1)
    slow = Speed(pixels=10.0 / photos.COARSE, gaussian=0.0)
    monkeypatch.setattr(photos, "_speed", lambda *_: slow)
    monkeypatch.setattr(photos, "ENOUGH", 7)


def slowly(scene, seconds):
    def read(view):
        return replace(view, load=lambda: time.sleep(seconds) or view.load())

    return replace(scene, views=tuple(map(read, scene.views)))


@given(
    pixels=st.integers(10_000, 50_000_000), points=st.integers(1, 10**6),
    seconds=st.floats(-10, 1000), most=st.floats(1, 64),
)  # fmt: skip
def test_photos_are_halved_until_enough_steps_fit_and_no_further(pixels, points, seconds, most):
    factor = size_factor(pixels, points=points, speed=SPEED, seconds=seconds, most=most)

    def fit_at(factor):
        return seconds / step_seconds(pixels, factor, points, SPEED)

    assert factor in (1, 2, 4, 8, 16, 32, 64)
    assert factor <= most
    assert factor == 1 or fit_at(factor / 2) < ENOUGH
    assert fit_at(factor) >= ENOUGH or 2 * factor > most


def test_a_step_goes_by_pixels_and_by_gaussians():
    still = replace(SPEED, gaussian=0.0)
    assert step_seconds(10_000, 1.0, 0, still) == photos.COARSE * SPEED.pixels
    assert step_seconds(10_000, 2.0, 0, still) == photos.COARSE * SPEED.pixels / 4
    dense = replace(SPEED, pixels=0.0)
    for points, gaussians in ((0, 2000), (900, 2000), (1500, 3000), (9000, 5000)):
        assert step_seconds(10_000, 1.0, points, dense) == pytest.approx(gaussians * SPEED.gaussian)


@pytest.mark.usefixtures("large")
def test_large_photos_are_shrunk_and_the_plan_says_why():
    scene = tiny_scene()
    found = planned_photos(scene, ASKED, RUN)  # two steps at full size, eight at half
    assert (found.factor, found.train) == (2.0, scene.train)
    (told,) = found.choices
    assert told.value == "1/2 of 24 x 18 pixels"
    assert told.because in (
        "at full size about 1 steps would fit, and 7 are wanted",
        "at full size about 2 steps would fit, and 7 are wanted",
    )
    small = working(scene, replace(found, factor=1.125))  # no side falls below 16 pixels
    for index, view in enumerate(small.views):
        size = (16, 21) if index in scene.train else (18, 24)
        assert view.size == size
        assert view.load().shape == (*size, 3)
    assert small.train == scene.train


@pytest.mark.usefixtures("large")
def test_what_reading_takes_is_not_left_for_steps(monkeypatch):
    scene = slowly(tiny_scene(), 0.8)  # four of twenty seconds: six steps at half size
    monkeypatch.setattr(photos, "FEWEST", 5)
    assert planned_photos(scene, ASKED, RUN).factor == 4


@pytest.mark.usefixtures("large")
def test_photos_are_large_from_the_next_pixel_on(monkeypatch):
    monkeypatch.setattr(photos, "LARGE", PIXELS)
    scene = tiny_scene()
    assert planned_photos(scene, ASKED, RUN) == Photos(train=scene.train)


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("asked", [{"steps": 5}, {"coarsest": 2.0}])
def test_photos_keep_their_size_where_it_or_the_steps_are_given(asked):
    scene = tiny_scene()
    assert planned_photos(scene, replace(ASKED, **asked), RUN) == Photos(train=scene.train)


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("lost", ["load_prior", "load_sweep", "load_sky"])
def test_photos_that_would_lose_something_keep_their_size(lost):
    scene = tiny_scene()
    views = list(scene.views)
    there: dict[str, Any] = {lost: lambda: None}
    views[2] = replace(views[2], **there)
    scene = replace(scene, views=tuple(views))
    assert planned_photos(scene, ASKED, RUN) == Photos(train=scene.train)


def test_small_photos_are_left_alone_and_nothing_is_read():
    def never():
        raise AssertionError

    scene = tiny_scene()
    scene = replace(scene, views=tuple(replace(view, load=never) for view in scene.views))
    assert planned_photos(scene, ASKED, RUN) == Photos(train=scene.train)


@pytest.mark.usefixtures("large")
def test_no_more_photos_are_read_than_there_is_time_for(monkeypatch):
    scene = tiny_scene(views=11)
    monkeypatch.setattr(photos, "read_seconds", lambda *_: 0.05)
    monkeypatch.setattr(photos, "FEWEST", 2)
    found = planned_photos(scene, replace(ASKED, seconds=1.0), RUN)
    assert 5 <= len(found.train) <= photos.READING * 1.0 / 0.05
    gaps = {b - a for a, b in zip(found.train, found.train[1:], strict=False)}
    assert max(gaps) - min(gaps) <= 1  # evenly
    assert found.train[-1] - found.train[0] >= 6  # along the whole flight
    told = found.choices[-1]
    assert told.value == f"{len(found.train)} of 10, evenly"
    assert told.because.startswith("reading one takes 0.0")
    monkeypatch.setattr(photos, "FEWEST", 20)
    assert planned_photos(scene, replace(ASKED, seconds=1.0), RUN).train == scene.train


@pytest.mark.usefixtures("large")
def test_photos_that_memory_does_not_hold_are_halved_and_then_left_out(monkeypatch):
    monkeypatch.setattr(photos, "FEWEST", 2)
    scene, whole = tiny_scene(), 5 * PIXELS / 4 * 12
    assert planned_photos(scene, ASKED, replace(RUN, image_bytes=int(whole))).factor == 2
    found = planned_photos(scene, ASKED, replace(RUN, image_bytes=int(whole) - 1))
    assert found.factor == 4
    assert found.choices[0].because.endswith(
        " steps would fit, and 7 are wanted; 0 MB hold no more of 5 photos"
    )
    monkeypatch.setattr(photos, "SHORT_SIDE", 9)
    found = planned_photos(scene, ASKED, replace(RUN, image_bytes=3 * PIXELS // 4 * 12))
    assert (found.factor, len(found.train)) == (2, 3)
    assert "hold no more" not in found.choices[0].because  # the steps halved them
    assert "MB hold no more" in found.choices[-1].because
    monkeypatch.setattr(
        photos, "ENOUGH", 0
    )  # at full size they are read again, no slower than a step
    found = planned_photos(scene, ASKED, replace(RUN, image_bytes=1))
    assert (found.factor, found.train, found.choices) == (1.0, scene.train, ())


def test_photos_are_read_side_by_side_only_as_far_as_memory_goes(monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
    views, one = tiny_scene().train_views, photos.READING_BYTES * PIXELS
    found = [reading_threads(1.0, views, room) for room in (0, one, 3 * one, 99 * one)]
    assert found == [1, 1, 3, 4]
    assert reading_threads(4.0, views, one) == 1  # in memory they have all their pixels first
    assert reading_threads(1.0, [], one) == 4


@pytest.mark.parametrize(
    ("name", "factor", "readers"),
    [("a.jpg", 1.0, 2), ("a.jpg", 2.0, 2), ("a.JPEG", 4.0, 8), ("a.jpg", 64.0, 128),
     ("a.png", 4.0, 2), ("a.tif", 4.0, 2)],
)  # fmt: skip
def test_only_a_jpeg_is_decoded_at_a_part_of_its_size(monkeypatch, name, factor, readers):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1000)
    monkeypatch.setattr(photos, "SHORT_SIDE", 1)
    size = (6400, 4800)
    truth = Truth(
        path=Path(name), photo_size=size, undistortion=None, shrunk=size, size=size, filter="area",
        positions=TensorCache(0),
    )  # fmt: skip
    view = replace(sized(tiny_scene().views[0], *size), load=truth)
    room = 2 * photos.READING_BYTES * 6400 * 4800
    assert reading_threads(factor, [view], room) == readers


def test_the_middle_photo_is_one_that_somebody_took():
    views = tiny_scene(views=3).views
    sizes = [(40, 30), (30, 40), (10, 10)]
    turned = [
        replace(view, camera=replace(view.camera, width=width, height=height))
        for view, (width, height) in zip(views, sizes, strict=True)
    ]
    assert middle_photo(turned) is turned[0]
    assert middle_photo(views) is views[1]


def sized(view, width, height):
    """The view with a grey photo of another size."""
    return replace(
        view, camera=camera(0, width=width, height=height),
        load=lambda: torch.full((height, width, 3), 0.5),
    )  # fmt: skip


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("place", [0, 1, 3, 5])
def test_one_small_photo_among_large_ones_changes_nothing_for_them(monkeypatch, place):
    monkeypatch.setattr(photos, "SHORT_SIDE", 20)
    scene = tiny_scene()
    views = tuple(sized(view, 64, 48) for view in scene.views)
    mixed = (*views[:place], sized(views[place], 32, 24), *views[place + 1 :])
    alike, found = (
        planned_photos(replace(scene, views=views), ASKED, RUN) for views in (views, mixed)
    )
    assert (found.factor, found.train) == (alike.factor, alike.train) == (2.0, scene.train)
    (told,) = found.choices
    assert told.value == "1/2 of 64 x 48 pixels"
    for index, view in enumerate(working(replace(scene, views=mixed), found).views):
        small, large = ((24, 32), (48, 64)) if index == 0 else ((20, 27), (24, 32))
        assert view.size == (small if index == place else large)
        assert view.load().shape == (*view.size, 3)


def test_speed_is_measured_on_photos_of_one_size_whatever_sizes_there_are(monkeypatch):
    seen = []
    monkeypatch.setattr(photos, "MEASURED", 600)
    monkeypatch.setattr(
        photos, "measure", lambda scene, *_: seen.extend(scene.train_views) or SPEED
    )
    scene = tiny_scene()
    views = [sized(view, 64, 48) for view in scene.views]
    views[1] = sized(views[1], 24, 18)
    photos._speed(replace(scene, views=tuple(views)), ASKED, RUN)
    assert [view.size for view in seen] == [(18, 24), *[(21, 28)] * 2]


def many(count):
    """A scene of so many training photos, named alike."""
    scene = tiny_scene()
    return replace(scene, views=(scene.views[1],) * count, train=tuple(range(count)), test=())


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize(
    ("together", "each", "factor", "train"),
    [
        (1, 0.05, 4, 119),  # 14 of 20 seconds are left for steps: five at half size
        (4, 0.05, 2, 119),  # 18.5 seconds: seven
        (1, 0.2, 4, 30),  # only photos that are read take time
        (1, 0.1, 4, 60),
    ],
)
def test_photos_are_read_side_by_side_and_only_those_that_are_read_take_time(
    monkeypatch, together, each, factor, train
):
    monkeypatch.setattr(torch, "get_num_threads", lambda: together)
    monkeypatch.setattr(photos, "read_seconds", lambda *_: each)
    found = planned_photos(many(119), ASKED, Run())
    assert (found.factor, len(found.train), found.readers) == (factor, train, together)
    told = found.choices[0]
    assert (
        told.because
        == f"at full size about {1 + (together == 4)} steps would fit, and 7 are wanted"
    )
    expected = (20 - min(train, 119) * each / together) / 10 * factor**2
    assert told.expects in {f"about {expected - late:.0f} steps" for late in (0.0, 0.1)}


@pytest.mark.usefixtures("large")
def test_the_plan_says_where_reading_alone_takes_longer_than_there_is(monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    monkeypatch.setattr(photos, "read_seconds", lambda *_: 5.0)
    found = planned_photos(many(20), ASKED, Run())
    assert len(found.train) == photos.FEWEST
    size, fewer = found.choices
    assert size.because == "reading 12 photos takes 60 s of 20"
    assert size.expects == "hardly any step"
    assert (fewer.value, fewer.because) == ("12 of 20, evenly", "reading one takes 5.00 s")
    assert fewer.expects == "40 s of reading saved"


@pytest.mark.usefixtures("large")
def test_completed_depths_take_small_photos_too(monkeypatch):
    monkeypatch.setattr(photos, "_speed", lambda *_: Speed(pixels=0.8, gaussian=0.0))
    facts: dict[str, str] = {}
    asked = replace(ASKED, seconds=3.0, completed=True)
    model = fit(aerial_scene().for_training(), asked, replace(RUN, on_fact=facts.__setitem__))
    assert model.kind == "stratosplat"
    assert facts["plan: photos' size"].startswith("1/2 of 24 x 18 pixels")


def test_a_scene_without_training_views_is_refused_in_the_usual_words():
    with pytest.raises(DataError, match="no training views"):
        fit(replace(tiny_scene(), train=()), ASKED, RUN)


@pytest.mark.usefixtures("large")
def test_a_killed_run_goes_on_with_the_photos_of_its_plan(tmp_path, monkeypatch):
    monkeypatch.setattr(photos, "FEWEST", 2)
    fifth = Speed(pixels=0.2 / photos.COARSE, gaussian=0.0)
    monkeypatch.setattr(photos, "_speed", lambda *_: fifth)
    asked = replace(ASKED, seconds=1.0)  # at most six photos of ten, half as large
    scene = slowly(tiny_scene(views=11), 0.05)

    def killing(step, total, values):
        if step == 20:
            raise Killed

    run = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(scene, asked, replace(run, report=killing))
    told = json.loads((tmp_path / "checkpoint" / PLAN).read_text())
    assert told["factor"] == 2.0
    assert 2 <= len(told["train"]) <= 6
    monkeypatch.setattr(
        "splatproof.methods.auto.fit.planned_photos", lambda *_: pytest.fail("again")
    )
    model = fit(scene, asked, run)
    assert isinstance(model, ExplicitModel)
    assert all(torch.isfinite(getattr(model.model, name)).all() for name in FIELDS)
