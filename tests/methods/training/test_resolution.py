"""Small photos first: the schedule, the shrunk views, and a training that uses both."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.city.settings import OdbpStitch
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.resolution import LEAST_SIDE, Resolution, shrunk

RESOLUTIONS = st.builds(
    Resolution, coarsest=st.floats(1, 64), full_from=st.floats(0, 1, exclude_max=False)
)


@given(resolution=RESOLUTIONS, total=st.integers(1, 300))
def test_photos_only_grow_and_end_at_their_size(resolution, total):
    factors = [resolution.factor(step, total) for step in range(1, total + 1)]
    assert factors == sorted(factors, reverse=True)
    assert all(1 <= factor <= resolution.coarsest for factor in factors)
    if resolution.full_from < 1:
        assert resolution.factor(total, total) == 1 or (total - 1) / total < resolution.full_from
    mean = sum(factor**-2 for factor in factors) / total
    assert resolution.relative_pixels(total) == pytest.approx(mean)


def test_two_halvings_take_a_third_and_two_thirds_of_their_time():
    resolution = Resolution(coarsest=4.0, full_from=0.6)
    factors = [resolution.factor(step, 100) for step in range(1, 101)]
    assert [factors.count(factor) for factor in (4, 2, 1)] == [20, 40, 40]


@pytest.mark.parametrize(
    "values", [{"coarsest": 0.5}, {"full_from": 1.5}, {"coarsest": float("nan")}]
)
def test_impossible_schedules_are_refused(values):
    with pytest.raises(UsageError, match="resolution"):
        Resolution(**values)


@settings(max_examples=15)
@given(factor=st.floats(1, 8))
def test_a_shrunk_view_looks_at_the_same_things(factor):
    """Rays through the corners of the image stay, and a mean over the photo too."""
    view = tiny_scene().train_views[0]
    small = shrunk(view, factor)
    assert small.load().shape[:2] == (small.camera.height, small.camera.width)
    assert min(small.size) >= min(LEAST_SIDE, *view.size)
    for one in (view, small):
        corner = torch.tensor([one.camera.width, one.camera.height, 1.0], dtype=torch.float64)
        ray = one.camera.K.double().inverse() @ corner
        assert torch.allclose(ray, view.camera.K.double().inverse() @ torch.tensor(
            [view.camera.width, view.camera.height, 1.0], dtype=torch.float64), atol=1e-5)  # fmt: skip
    assert float(small.load().mean()) == pytest.approx(float(view.load().mean()), abs=1e-5)


def test_a_pixel_counts_where_all_that_it_covers_does():
    view = tiny_scene().train_views[0]
    mask = torch.ones(view.size, dtype=torch.bool)
    mask[0, 0] = False
    small = shrunk(replace(view, load_mask=lambda: mask), 2.0)
    assert small.load_mask is not None
    found = small.load_mask()
    assert not found[0, 0]
    assert int((~found).sum()) == 1


@settings(max_examples=15)
@given(width=st.integers(17, 300), height=st.integers(17, 300), factor=st.floats(1, 8))
def test_no_pixel_is_lost_where_all_count(width, height, factor):
    """A mean of ones over two and a third pixels is not 1 in float32."""
    view = tiny_scene().train_views[0]
    view = replace(
        view, camera=replace(view.camera, width=width, height=height),
        load_mask=lambda: torch.ones(height, width, dtype=torch.bool),
    )  # fmt: skip
    small = shrunk(view, factor)
    assert small.load_mask is not None
    found = small.load_mask()
    assert found.shape == small.size
    assert found.all()


def test_training_renders_small_views_first():
    scene, run = tiny_scene(), Run(threads=1)
    settings = Settings(iterations=8, resolution=Resolution(coarsest=2.0, full_from=0.5))
    trainer = Trainer(*prepare(scene, settings, run), run)
    sizes = []
    for _ in range(8):
        trainer.advance()
        sizes.append(trainer.sized(scene.train_views[0]).camera.width)
    whole = scene.train_views[0].camera.width
    assert sizes == [max(LEAST_SIDE, round(whole / 2))] * 4 + [whole] * 4


def test_photos_that_are_as_small_as_can_be_stay_as_they_are():
    """Shrunk to its own size, a photo once waited for itself, for ever."""
    scene, run = tiny_scene(), Run(threads=1)
    scene = replace(scene, views=tuple(shrunk(view, 9.0) for view in scene.views))
    settings = Settings(iterations=4, resolution=Resolution(coarsest=2.0, full_from=0.5))
    trainer = Trainer(*prepare(scene, settings, run), run)
    (view, *_) = scene.train_views
    trainer.step = 1
    assert view.size == (LEAST_SIDE, LEAST_SIDE)
    assert trainer.sized(view) is view
    assert trainer.photo(trainer.sized(view)).shape[:2] == view.size


def test_the_loss_falls_whatever_the_sizes():
    losses = []
    run = Run(threads=1, report=lambda step, total, values: losses.append(values["loss"]))
    fit(tiny_scene(), Settings(iterations=100, resolution=Resolution(coarsest=2.0)), run)
    assert losses[-1] < 0.7 * losses[0]


def test_blocks_refuse_it():
    with pytest.raises(UsageError, match="coarsest"):
        OdbpStitch(resolution=Resolution(coarsest=2.0))
