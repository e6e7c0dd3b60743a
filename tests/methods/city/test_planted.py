"""Planted seams: blocks differ in light and place by as much as is asked for, and in nothing on average."""

import math
import pickle
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.city_scene import small_scene
from splatproof.base.errors import UsageError
from splatproof.methods.city.ground import ground
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.planted import NO_PLANT, PlantSettings, planted_views
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.initialise import extent
from splatproof.reference.types.camera import transform_points

SCENE = small_scene(60)
FRAME = ground(SCENE).frame
GREY = replace(
    SCENE, views=tuple(replace(one, load=lambda: torch.full((3, 4, 3), 0.5)) for one in SCENE.views)
)


def light_of(planted: PlantSettings, block: int, blocks: int) -> torch.Tensor:
    """Factors on the colours of grey photos."""
    view = planted_views(GREY, planted, block, blocks, FRAME)[0]
    return view.load()[0, 0] / 0.5


@settings(max_examples=15)
@given(light=st.floats(0.01, 0.6), blocks=st.integers(2, 8))
def test_no_light_is_added_over_blocks_or_over_colours(light: float, blocks: int):
    planted = PlantSettings(light=light)
    factors = torch.stack([light_of(planted, block, blocks) for block in range(blocks)])
    assert_close(factors.log().sum(dim=0), torch.zeros(3), rtol=0, atol=1e-5)
    assert_close(factors.log().sum(dim=1), torch.zeros(blocks), rtol=0, atol=1e-5)
    assert_close(factors[0, 0], torch.tensor(math.exp(light)))
    apart = (factors[:, None] - factors[None]).abs().sum(dim=2) + torch.eye(blocks)
    assert float(apart.min()) > 0  # no two blocks are alike


@given(shift=st.floats(0.001, 0.5), blocks=st.integers(2, 8))
def test_cameras_move_along_the_ground_by_the_share_that_is_asked_for(shift: float, blocks: int):
    planted = PlantSettings(shift=shift)
    moves = []
    for block in range(blocks):
        views = planted_views(SCENE, planted, block, blocks, FRAME)
        for before, after in zip(SCENE.views, views, strict=True):
            assert torch.equal(before.camera.rotation, after.camera.rotation)
            assert torch.equal(before.load(), after.load())
            moves.append(FRAME @ (after.camera.centre - before.camera.centre))
    moved = torch.stack(moves)
    assert_close(moved[:, 2], torch.zeros(len(moved)).double(), rtol=0, atol=1e-9)
    assert_close(moved.norm(dim=1), torch.full((len(moved),), shift * extent(SCENE)).double())
    assert float(moved.sum(dim=0).norm()) < 1e-6 * len(moved)
    first = torch.tensor([shift * extent(SCENE), 0.0, 0.0]).double()
    assert_close(moved[0], first, rtol=1e-6, atol=1e-9)  # block 0: along the flight


def test_the_ground_is_that_of_the_frame():
    frame = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).double()  # up is x
    after = planted_views(SCENE, PlantSettings(shift=0.2), 0, 2, frame)[0].camera.centre
    move = after - SCENE.views[0].camera.centre
    assert_close(move, torch.tensor([0.0, 0.2 * extent(SCENE), 0.0]).double())


def test_no_photo_becomes_brighter_than_white():
    bright = replace(
        SCENE,
        views=tuple(replace(one, load=lambda: torch.full((3, 4, 3), 0.9)) for one in SCENE.views),
    )
    seen = planted_views(bright, PlantSettings(light=0.5), 0, 2, FRAME)[0].load()
    assert seen[..., 0].unique().tolist() == [1.0]
    assert_close(seen[..., 1], torch.full((3, 4), 0.9 * math.exp(-0.25)))


def test_what_moves_with_the_cameras_looks_the_same():
    """So a block that is trained on moved cameras is the same block, moved."""
    views = planted_views(SCENE, PlantSettings(shift=0.1), 1, 3, FRAME)
    points = SCENE.points.positions
    for before, after in zip(SCENE.views, views, strict=True):
        move = after.camera.centre - before.camera.centre
        seen = transform_points(after.camera, points + move)
        assert_close(seen, transform_points(before.camera, points))


def test_jobs_have_what_is_planted_and_keys_of_their_own(tmp_path):
    found = partition(SCENE, 2, PartitionSettings(margin=0.1))

    def jobs(planted: PlantSettings):
        return block_jobs(SCENE, found, Settings(iterations=3), Run(), tmp_path, planted=planted)

    plain, lit, moved = (
        jobs(p) for p in (NO_PLANT, PlantSettings(light=0.2), PlantSettings(shift=0.1))
    )
    for block in range(2):
        keys = {one[block].key for one in (plain, lit, moved)}
        assert len(keys) == 3
        photo, planted = (one[block].scene.views[0].load() for one in (plain, lit))
        factors = torch.exp(0.2 * torch.cos(math.pi * block + torch.arange(3) * 2 * math.pi / 3))
        assert_close(planted, (photo * factors).clamp(0, 1))
        assert torch.equal(photo, moved[block].scene.views[0].load())
        assert not torch.equal(
            plain[block].scene.views[0].camera.centre, moved[block].scene.views[0].camera.centre
        )


def test_what_is_planted_survives_the_way_to_another_process():
    scene = replace(SCENE, views=tuple(replace(one, load=_grey) for one in SCENE.views))
    view = planted_views(scene, PlantSettings(light=0.3, shift=0.1), 0, 2, FRAME)[0]
    there = pickle.loads(pickle.dumps(view))
    assert torch.equal(there.load(), view.load())
    assert torch.equal(there.camera.world_to_camera, view.camera.world_to_camera)


def _grey() -> torch.Tensor:
    return torch.full((3, 4, 3), 0.5)


@pytest.mark.parametrize("name", ["light", "shift"])
@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan])
def test_what_cannot_be_planted_is_refused(name: str, value: float):
    with pytest.raises(UsageError, match=f"planted.{name}"):
        PlantSettings(**{name: value})
