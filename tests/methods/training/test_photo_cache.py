"""Photos that fit stay from round to round, what passes has a little room, and small sizes leave when they are outgrown."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.ahead import PHOTO_BYTES
from splatproof.methods.training.image_room import READING_BYTES, STEP_BYTES, ImageRoom
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.photo_cache import PhotoCache
from splatproof.methods.training.resolution import Resolution, shrunk

PIXELS = 24 * 18
PHOTO = PHOTO_BYTES * PIXELS
PHOTOS = 20


def allowing(photos: float) -> int:
    """Bytes of an allowance that keeps so many photos beside a step and the reading of the next."""
    return int(photos * PHOTO) + (STEP_BYTES + READING_BYTES) * PIXELS


def trainer(reads, allowed, *, rounds=6, scene=None, **settings) -> Trainer:
    def counted(view):
        return replace(view, load=lambda: reads.append(view.name) or view.load())

    scene = scene or tiny_scene(views=PHOTOS + 1)
    scene = replace(scene, views=tuple(map(counted, scene.views)))
    run = Run(threads=1, image_bytes=allowed)
    made = Settings(iterations=rounds * PHOTOS, sh_degree=0, **settings)
    return Trainer(*prepare(scene, made, run), run)


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize(("share", "hits"), [(0.8, 0.6), (0.5, 0.3), (0.25, 0.05)])
def test_photos_that_are_kept_are_found_in_every_round(share, hits, ahead):
    """At least all but three of those that fit, which is the room of what passes; next to none of dropped ones."""
    reads: list[str] = []
    found = trainer(reads, allowing(share * PHOTOS))
    assert found.room.ahead
    if ahead:
        found.train()
    while found.step < found.plan.steps:
        found.advance()
        assert found.images.held <= found.images.limit == found.room.kept
    later = 5 * PHOTOS
    assert len(reads) <= PHOTOS + later - 5 * (share * PHOTOS - 3)
    assert 1 - (len(reads) - PHOTOS) / later >= hits


def test_all_photos_that_fit_are_read_once():
    reads: list[str] = []
    found = trainer(reads, allowing(PHOTOS))
    found.train()
    assert len(reads) == PHOTOS


@pytest.mark.parametrize("photos", [0.0, 0.5, 1.0, 2.5, 7.0])
def test_no_number_depends_on_what_is_kept(photos):
    models = []
    for allowed in (allowing(99), int(photos * PHOTO)):
        found = trainer([], allowed, rounds=2, resolution=Resolution(coarsest=1.5, full_from=0.5))
        found.train()
        models.append(found.model.parameters.trained)
    for name, value in models[0].items():
        assert torch.equal(value, models[1][name])


@pytest.mark.parametrize("masked", [False, True])
def test_small_photos_have_the_room_first_and_leave_when_they_are_outgrown(masked):
    """Two rounds at a quarter of the size, four at half and two at full size, in room for half of the photos."""
    reads: list[str] = []
    scene = tiny_scene(
        views=PHOTOS + 1, mask=torch.ones(18, 24, dtype=torch.bool) if masked else None
    )
    large = replace(scene, views=tuple(twice(view) for view in scene.views))
    allowed = 4 * allowing(PHOTOS / 2)
    found = trainer(
        reads, allowed, rounds=8, scene=large, resolution=Resolution(coarsest=4.0, full_from=0.75)
    )
    counts, sizes = [], []
    for _ in range(8):
        before = len(reads)
        for _ in range(PHOTOS):
            found.advance()
            assert found.images.held <= found.images.limit
        counts.append(len(reads) - before)
        sizes.append(found.sized(found.plan.views[0]).camera.width)
    assert sizes == [16, 16, 24, 24, 24, 24, 48, 48]
    assert counts[0] == PHOTOS
    assert counts[1] == counts[3] == counts[4] == counts[5] == 0  # small ones are all there
    assert 0 < counts[2] < PHOTOS  # made of full photos, some of which are there
    assert PHOTOS - 10 <= counts[7] <= PHOTOS - 6  # half of them less what may pass
    assert found.images._small.held == 0


def twice(view):
    """The view with a photo of twice the size on each side."""
    camera = view.camera
    K = camera.K.clone()
    K[:2] *= 2
    mask = view.load_mask
    return replace(
        view, camera=replace(camera, K=K, width=48, height=36),
        load=lambda: view.load().repeat_interleave(2, 0).repeat_interleave(2, 1),
        load_mask=None if mask is None
        else lambda: mask().repeat_interleave(2, 0).repeat_interleave(2, 1),
    )  # fmt: skip


def test_what_passes_has_room_for_the_present_photo_and_those_that_come():
    views = tiny_scene(views=9).views
    for ahead, photos in ((True, 3), (False, 1)):
        cache = PhotoCache(ImageRoom(kept=8 * PHOTO, ahead=ahead), views)
        assert cache.passing == photos * PHOTO
    assert PhotoCache(ImageRoom(kept=PHOTO, ahead=True), views).passing == PHOTO
    assert PhotoCache(ImageRoom(kept=PHOTO, ahead=True), []).passing == 0


def test_photos_of_full_size_give_way_to_small_ones():
    views = tiny_scene(views=9).views
    cache = PhotoCache(ImageRoom(kept=10 * PHOTO, ahead=False), views)
    for view in views:
        cache.get((view.name, view.size, "image"), view.load)
    assert cache._whole.held == 9 * PHOTO
    cache.resize(1.125)
    small = sum(
        PHOTO_BYTES * one.camera.width * one.camera.height
        for one in (shrunk(view, 1.125) for view in views)
    )
    assert cache._small.limit == small
    assert cache._whole.held <= 9 * PHOTO - small
    cache.resize(1.0)
    assert (cache._small.limit, cache._whole.limit) == (0, 9 * PHOTO)
