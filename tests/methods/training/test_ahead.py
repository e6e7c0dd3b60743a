"""Photos are read ahead: the same training, no photo read for nothing, and memory that holds."""

import threading
from contextlib import closing
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.side_views import SideOrder
from splatproof.methods.sparse_views.twin_fields import Paired
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.ahead import PHOTO_BYTES, Ahead
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.view_order import Shuffled, ViewOrder

SETTINGS = Settings(iterations=30, sh_degree=0)


def trainer(scene, **more) -> Trainer:
    run = Run(threads=1, **more)
    return Trainer(*prepare(scene, SETTINGS, run), run)


@given(count=st.integers(1, 12), draws=st.integers(0, 40), seed=st.integers(0, 99))
def test_what_is_said_to_come_comes(count, draws, seed):
    generator = torch.Generator().manual_seed(seed)
    sides = SideOrder(count, 0, steps=100, every=0, refresh=10, views_per_step=1)
    orders: tuple[ViewOrder, ...] = (Shuffled(count), Paired(count), sides)
    for order in orders:
        for _ in range(draws):
            order.next(generator)
        before = generator.get_state()
        said = list(order.coming())
        assert torch.equal(generator.get_state(), before), "nothing is drawn"
        assert len(said) <= 2 * count
        if isinstance(order, Paired):  # the second field sees what the first one saw
            said = said[:1]
        assert said == [order.next(generator) for _ in said]


def test_reading_ahead_changes_nothing_but_who_reads():
    readers: dict[str, list[str]] = {}

    def watched(view):
        def load():
            readers.setdefault(view.name, []).append(threading.current_thread().name)
            return view.load()

        return replace(view, load=load)

    plain = trainer(tiny_scene(views=8))
    while plain.step < plain.plan.steps:
        plain.advance()
    scene = tiny_scene(views=8)
    ahead = trainer(replace(scene, views=tuple(watched(view) for view in scene.views)))
    ahead.train()
    for name, value in plain.model.parameters.trained.items():
        assert torch.equal(value, ahead.model.parameters.trained[name])
    assert all(len(each) == 1 for each in readers.values()), "no photo is read twice"
    assert any(each[0].startswith("photos ahead") for each in readers.values())


@pytest.mark.parametrize(("photos", "asked"), [(1, 0), (2, 1), (3, 2), (100, 2)])
def test_no_more_is_read_than_the_cache_holds(photos, asked):
    views = tiny_scene(views=8).views
    size = PHOTO_BYTES * views[0].camera.width * views[0].camera.height
    read = []
    with closing(Ahead(lambda view: read.append(view.name), photos * size)) as ahead:
        ahead.look(views[0], views[1:])
    assert read == [view.name for view in views[1 : 1 + asked]][: len(read)]
    assert len(read) <= asked
    assert read or not asked


def test_a_photo_that_cannot_be_read_is_the_steps_to_refuse():
    def broken():
        raise DataError("5.png: not a photo")

    scene = tiny_scene(views=8)
    views = list(scene.views)
    views[5] = replace(views[5], load=broken)
    with pytest.raises(DataError, match=r"5\.png: not a photo"):
        trainer(replace(scene, views=tuple(views))).train()
