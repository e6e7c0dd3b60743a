"""Colour fits undo exactly the maps they are named after, and survive degenerate images."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.images import noise_image, spoiled
from splatproof.base.errors import UsageError
from splatproof.metrics.colour_fit import fit_colours
from splatproof.metrics.pixel import psnr

KINDS = pytest.mark.parametrize("kind", ["cc_affine", "cc_quadratic"])


def inner(height: int, width: int, seed: int):
    """Noise in [0.2, 0.8]: nothing is clipped."""
    return 0.2 + 0.6 * noise_image(height, width, seed)


@KINDS
@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_equal_images_stay_as_they_are(kind, seed):
    image = inner(6, 7, seed)
    assert fit_colours(image, image, None, kind) == pytest.approx(image, abs=1e-6)


@KINDS
@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_recovers_an_affine_map(kind, seed):
    image = inner(8, 9, seed)
    mix = torch.eye(3) + 0.2 * (noise_image(3, 1, seed + 1)[:, 0] - 0.5)
    target = (image @ mix + 0.02).clamp(0, 1)
    assert fit_colours(image, target, None, kind) == pytest.approx(target, abs=1e-5)


def test_only_the_quadratic_fit_recovers_a_quadratic_map():
    image = inner(20, 20, 0)
    target = 0.1 + 0.5 * image**2 + 0.3 * image * image[..., [1, 2, 0]]
    assert fit_colours(image, target, None, "cc_quadratic") == pytest.approx(target, abs=1e-5)
    left = (fit_colours(image, target, None, "cc_affine") - target).abs().max()
    assert left > 0.01


@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_the_first_round_is_numpy_least_squares(seed):
    """With all values away from the ends the rounds after the first change nothing."""
    image, target = inner(10, 12, seed), inner(10, 12, seed + 1)
    columns = np.concatenate([image.reshape(-1, 3), np.ones((120, 1))], axis=1)
    want = columns @ np.linalg.lstsq(columns, target.reshape(-1, 3).numpy(), rcond=None)[0]
    got = fit_colours(image, target, None, "cc_affine").reshape(-1, 3).numpy()
    assert got == pytest.approx(want, abs=1e-5)


@KINDS
def test_the_result_stays_in_the_range(kind):
    """A steep map fitted to the middle overshoots at the ends."""
    image = noise_image(20, 20, 0)
    target = (2 * image - 0.5).clamp(0, 1)
    fitted = fit_colours(image, target, None, kind)
    assert fitted.max() == 1
    assert 0 <= fitted.min() < 1e-12  # the lowest may be met by rounding instead of the clamp


@KINDS
def test_clipped_pixels_take_no_part(kind):
    image = inner(20, 20, 0)
    target = 0.8 * image + 0.1
    target[:5] = 1.0  # blown out: says nothing about the map
    fitted = fit_colours(image, target, None, kind)
    assert fitted[5:] == pytest.approx(target[5:], abs=1e-5)


@KINDS
def test_masked_pixels_take_no_part(kind):
    image = inner(20, 20, 0)
    target = 0.8 * image + 0.1
    target[:5] = 1 - target[:5]
    mask = torch.ones(20, 20, dtype=torch.bool)
    mask[:5] = False
    fitted = fit_colours(image, target, mask, kind)
    assert fitted[5:] == pytest.approx(target[5:], abs=1e-5)


@KINDS
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_without_a_usable_pixel_nothing_changes(kind, value):
    image = torch.full((5, 6, 3), value)
    assert torch.equal(fit_colours(image, inner(5, 6, 0), None, kind), image)


@KINDS
def test_a_constant_image_becomes_the_mean(kind):
    """Rank one: the least-norm solution still predicts the best constant."""
    target = inner(5, 6, 0)
    fitted = fit_colours(torch.full((5, 6, 3), 0.5), target, None, kind)
    assert fitted == pytest.approx(target.mean(dim=(0, 1)).expand(5, 6, 3), abs=1e-5)


@KINDS
def test_is_deterministic_and_raises_psnr(kind):
    target = inner(30, 40, 0)
    image = spoiled(0.7 * target + 0.1, 0.02)
    fitted = fit_colours(image, target, None, kind)
    assert torch.equal(fitted, fit_colours(image, target, None, kind))
    assert psnr(fitted, target) > psnr(image, target) + 3


def test_an_unknown_kind_is_refused():
    image = inner(5, 6, 0)
    with pytest.raises(UsageError, match="no colour fit 'cc_cubic'"):
        fit_colours(image, image, None, "cc_cubic")
