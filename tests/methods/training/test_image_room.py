"""Photos that are kept and a step share one allowance."""

from dataclasses import replace

import pytest

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.image_room import (
    READING_BYTES,
    STEP_BYTES,
    image_allowance,
    image_room,
)
from splatproof.methods.training.loop import Trainer

MANY = 2**30


def views_of(width: int, height: int):
    view = tiny_scene(views=2).views[0]
    return [
        replace(view, camera=camera(0, width=w, height=h)) for w, h in ((8, 6), (width, height))
    ]


def test_a_step_on_the_largest_view_and_the_reading_of_the_next_are_taken_off():
    room = image_room(MANY, views_of(800, 600))
    assert (room.kept, room.ahead) == (MANY - (STEP_BYTES + READING_BYTES) * 800 * 600, True)
    assert image_room(MANY, []).kept == MANY


def test_large_photos_are_read_when_their_turn_comes():
    room = image_room(MANY, views_of(2800, 2800))
    assert (room.kept, room.ahead) == (MANY - STEP_BYTES * 2800 * 2800, False)


def test_the_largest_photos_leave_a_quarter():
    room = image_room(MANY, views_of(8000, 6000))
    assert (room.kept, room.ahead) == (MANY // 4, False)
    assert image_room(0, views_of(800, 600)).kept == 0
    assert not image_room(0, views_of(800, 600)).ahead


@pytest.mark.parametrize(("free", "allowed"), [(0.0, MANY), (3000.0, MANY), (10_240.0, 3 * MANY)])
def test_photos_may_take_a_share_of_free_memory_and_never_less_than_any_run_has(free, allowed):
    assert image_allowance(free) == allowed


@pytest.mark.parametrize("pixels", [24 * 18, 1])
def test_the_trainer_keeps_to_it(pixels):
    allowed = 200_000 * pixels // (24 * 18)
    scene, run = tiny_scene(), Run(threads=1, image_bytes=allowed)
    model, plan = prepare(scene, Settings(iterations=2), run)
    trainer = Trainer(model, plan, run)
    assert trainer.room == image_room(allowed, plan.views)
    assert trainer.images.limit == trainer.room.kept
    assert trainer.room.ahead == (pixels > 1)
