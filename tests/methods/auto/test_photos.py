"""Large photos: halved until enough steps fit, and no more of them than can be read."""

import json
import time
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.aerial_scene import aerial_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.auto import photos
from splatproof.methods.auto.fit import PLAN, fit
from splatproof.methods.auto.photos import (
    ENOUGH,
    Photos,
    middle_pixels,
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
    views[2] = replace(views[2], **{lost: lambda: None})
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
    scene = slowly(tiny_scene(views=11), 0.05)
    monkeypatch.setattr(photos, "FEWEST", 2)
    found = planned_photos(scene, replace(ASKED, seconds=1.0), RUN)
    assert 2 <= len(found.train) <= photos.READING * 1.0 / 0.05
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
    assert planned_photos(scene, ASKED, replace(RUN, image_bytes=int(whole) - 1)).factor == 4
    monkeypatch.setattr(photos, "SHORT_SIDE", 9)
    found = planned_photos(scene, ASKED, replace(RUN, image_bytes=3 * PIXELS // 4 * 12))
    assert (found.factor, len(found.train)) == (2, 3)
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


def test_the_middle_photo_is_one_that_somebody_took():
    views = tiny_scene(views=3).views
    sizes = [(40, 30), (30, 40), (10, 10)]
    turned = [
        replace(view, camera=replace(view.camera, width=width, height=height))
        for view, (width, height) in zip(views, sizes, strict=True)
    ]
    assert middle_pixels(turned) == 1200


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
