"""Levels of blocks: a planted light is found to its factor, and what is right is left as it is."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.methods.city.levels import (
    COVERED,
    MOST,
    Evidence,
    block_levels,
    evidence,
    levelled,
    levels,
)
from splatproof.methods.contracts.backends import get_backend
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View

CPU = get_backend("cpu")
SCENE = tiny_scene(views=5)


def covering() -> Gaussians:
    """A few Gaussians so wide and dense that they cover every view, in colours well inside [0, 1]."""
    start = random_gaussians(60)
    return replace(
        start,
        log_scales=torch.full_like(start.log_scales, 0.3),
        opacity_logits=torch.full_like(start.opacity_logits, 2.0),
        sh=start.sh * 0.2,
    )


def photos(model: Gaussians, noise: float = 0.0, most: float = 1.0) -> list[View]:
    """Views of the scene whose photos are renders of a model."""
    generator = torch.Generator().manual_seed(0)

    def seen(view: View) -> View:
        image = CPU.rasterize(
            view.camera, model.means, model.quaternions, model.scales, model.opacities, sh=model.sh
        ).colour
        image = image + noise * torch.randn(image.shape, generator=generator)
        return replace(view, load=lambda: image.clamp(0, most))

    return [seen(view) for view in SCENE.views]


MODEL = covering()
VIEWS = photos(MODEL)


def test_the_scene_of_these_tests_is_covered():
    for view in VIEWS:
        alpha = CPU.rasterize(
            view.camera, MODEL.means, MODEL.quaternions, MODEL.scales, MODEL.opacities, sh=MODEL.sh
        ).alpha
        assert float((alpha >= COVERED).float().mean()) > 0.3


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.lists(st.floats(0.7, 1.4), min_size=3, max_size=3), min_size=1, max_size=11),
    st.integers(0, 3),
)
def test_a_light_that_was_planted_is_found(factors, seed):
    """More than eight blocks take a second pass."""
    planted = torch.tensor(factors, dtype=torch.float64)
    generator = torch.Generator().manual_seed(seed)
    blocks = torch.randint(len(planted), (len(MODEL),), generator=generator)
    wrong = levelled(MODEL, blocks, planted)
    found = block_levels(wrong, blocks, len(planted), VIEWS, CPU)
    assert found.shape == planted.shape
    back = levelled(wrong, blocks, found)
    for view, one in zip(VIEWS, photos(back), strict=True):
        assert float((one.load() - view.load()).abs().mean()) < 2e-3


def test_its_factor_is_found_where_each_block_is_well_seen():
    blocks = torch.arange(len(MODEL)) % 2
    planted = torch.tensor([[0.8, 1.0, 1.2], [1.3, 0.9, 0.7]]).double()
    found = block_levels(levelled(MODEL, blocks, planted), blocks, 2, VIEWS, CPU)
    assert_close(found * planted, torch.ones_like(planted), rtol=0, atol=5e-3)


def test_a_model_that_is_right_is_left_as_it_is():
    blocks = torch.arange(len(MODEL)) % 3
    found = block_levels(MODEL, blocks, 3, VIEWS, CPU)
    assert_close(found, torch.ones_like(found), rtol=0, atol=1e-5)
    assert_close(levelled(MODEL, blocks, torch.ones(3, 3).double()).sh, MODEL.sh, rtol=0, atol=0)


def test_a_block_that_nobody_sees_keeps_its_colours():
    far = replace(MODEL, means=MODEL.means + torch.tensor([0.0, 0.0, 1e4]))
    both = Gaussians(**{name: torch.cat([getattr(MODEL, name), getattr(far, name)])
                        for name in vars(MODEL)})  # fmt: skip
    blocks = torch.arange(2).repeat_interleave(len(MODEL))
    wrong = levelled(both, blocks, torch.tensor([[0.8] * 3, [1.0] * 3]).double())
    found = block_levels(wrong, blocks, 2, VIEWS, CPU)
    assert_close(found, torch.tensor([[1.25] * 3, [1.0] * 3]).double(), rtol=0, atol=2e-3)
    nothing = Evidence(shown=torch.zeros(3, 2, 2).double(), photos=torch.zeros(3, 2).double())
    assert torch.equal(levels(nothing), torch.ones(2, 3).double())


def test_what_is_only_noisy_is_not_taken_for_darker():
    """Least squares divides by the noisy image's own energy, and would say so."""
    generator = torch.Generator().manual_seed(1)
    photo = torch.rand(200, 200, 3, generator=generator) * 0.2 + 0.4
    shares = torch.rand(200, 200, 1, generator=generator).repeat(1, 1, 2)
    shares[..., 1] = 1 - shares[..., 0]
    image = photo + 0.15 * torch.randn(photo.shape, generator=generator)
    found = levels(evidence(shares, shares[..., None] * image[:, :, None], photo))
    # 0.0064 at this draw: two shares of one pixel are hard to tell apart
    assert_close(found, torch.ones_like(found), rtol=0, atol=0.015)
    squares = (image * photo).sum() / (image * image).sum()
    assert float(squares) < 0.95


def test_clipped_and_bare_pixels_say_nothing():
    generator = torch.Generator().manual_seed(2)
    photo = torch.rand(50, 50, 3, generator=generator) * 0.6 + 0.2
    shares = torch.ones(50, 50, 1)
    image = photo[:, :, None] / 1.25
    clipped = photo.clone()
    clipped[:20] = 1.0  # the sun: the image has no such place
    found = levels(evidence(shares, image, clipped))
    assert_close(found, torch.full((1, 3), 1.25).double(), rtol=0, atol=2e-3)
    bare = shares.clone()
    bare[20:] = 0.5
    half = image * bare[..., None]
    found = levels(evidence(bare, half, photo))
    assert_close(found, torch.full((1, 3), 1.25).double(), rtol=0, atol=2e-3)


def test_what_a_mask_hides_says_nothing():
    counted = torch.ones(VIEWS[0].size, dtype=torch.bool)
    counted[:, 6:14] = False

    def hidden(view: View) -> View:
        photo = torch.where(counted[..., None], view.load(), 0.9)  # a hand in front of the lens
        return replace(view, load=lambda: photo, load_mask=lambda: counted)

    blocks, views = torch.arange(len(MODEL)) % 2, [hidden(view) for view in VIEWS]
    found = block_levels(MODEL, blocks, 2, views, CPU)
    assert_close(found, torch.ones_like(found), rtol=0, atol=1e-5)
    open_ = [replace(view, load_mask=None) for view in views]
    assert float((block_levels(MODEL, blocks, 2, open_, CPU) - 1).abs().max()) > 0.05


@pytest.mark.parametrize(("factor", "held"), [(0.1, MOST), (9.0, 1 / MOST)])
def test_no_factor_is_without_bounds(factor, held):
    blocks = torch.zeros(len(MODEL), dtype=torch.int64)
    wrong = levelled(MODEL, blocks, torch.full((1, 3), factor).double())
    found = block_levels(wrong, blocks, 1, VIEWS, CPU)
    assert_close(found, torch.full((1, 3), held).double())
