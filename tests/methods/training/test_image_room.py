"""Photos that are kept and a step share one allowance."""

from dataclasses import replace

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.image_room import STEP_BYTES, image_room
from splatproof.methods.training.loop import Trainer

MANY = 2**30


def views_of(width: int, height: int):
    view = tiny_scene(views=2).views[0]
    return [
        replace(view, camera=camera(0, width=w, height=h)) for w, h in ((8, 6), (width, height))
    ]


def test_a_step_on_the_largest_view_is_taken_off():
    assert image_room(MANY, views_of(800, 600)) == MANY - STEP_BYTES * 800 * 600
    assert image_room(MANY, []) == MANY


def test_the_largest_photos_leave_a_quarter():
    assert image_room(MANY, views_of(8000, 6000)) == MANY // 4
    assert image_room(0, views_of(800, 600)) == 0


def test_the_trainer_keeps_to_it():
    scene, run = tiny_scene(), Run(threads=1, image_bytes=100_000)
    model, plan = prepare(scene, Settings(iterations=2), run)
    trainer = Trainer(model, plan, run)
    assert trainer.images.limit == 100_000 - STEP_BYTES * 24 * 18
