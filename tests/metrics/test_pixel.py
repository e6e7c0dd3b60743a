"""PSNR and L1 against scikit-image, torch, and numbers worked by hand."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio

from helpers.images import noise_image, pairs, photo, random_mask, spoiled
from splatproof.metrics.pixel import l1, psnr, psnr_of_mse


@given(pairs())
def test_agrees_with_scikit_image_and_torch(pair):
    image, target = pair
    if not torch.equal(image, target):
        want = peak_signal_noise_ratio(target.numpy(), image.numpy(), data_range=1)
        assert psnr(image, target) == pytest.approx(want, abs=1e-4)  # theirs squares in float32
    assert l1(image, target) == pytest.approx(float((image - target).abs().mean()), abs=1e-6)


def test_worked_by_hand():
    target = torch.zeros(2, 2, 3)
    image = target.clone()
    image[0, 0, 0] = 0.5  # one number of twelve: MSE = 0.25 / 12, L1 = 0.5 / 12
    assert psnr(image, target) == pytest.approx(10 * math.log10(48), abs=1e-12)
    assert l1(image, target) == pytest.approx(1 / 24, abs=1e-12)


def test_the_peak_is_one_whatever_the_data():
    dark = 0.1 * noise_image(20, 30, 0)
    assert psnr(dark + 0.01, dark) == pytest.approx(40, abs=1e-4)  # float32 of 0.01


@given(pairs())
def test_equal_images_are_inf_and_order_does_not_matter(pair):
    image, target = pair
    assert psnr(target, target) == math.inf
    assert l1(target, target) == 0
    assert psnr(image, target) == psnr(target, image) >= 0


def test_ends_of_the_range():
    black, white = torch.zeros(3, 3, 3), torch.ones(3, 3, 3)
    assert psnr(black, white) == 0
    assert l1(black, white) == 1


@given(pairs(smallest=4), st.floats(0.1, 0.9), st.integers(0, 99))
def test_a_mask_scores_exactly_the_valid_pixels(pair, share, seed):
    image, target = pair
    mask = random_mask(image.shape[0], image.shape[1], share, seed)
    chosen, wanted = image[mask][None], target[mask][None]  # the valid pixels as a 1 x n image
    assert psnr(image, target, mask) == psnr(chosen, wanted)
    assert l1(image, target, mask) == l1(chosen, wanted)


@pytest.mark.parametrize("metric", [psnr, l1])
def test_no_valid_pixel_is_nan(metric):
    image = noise_image(5, 6, 0)
    assert math.isnan(metric(image, 1 - image, torch.zeros(5, 6, dtype=torch.bool)))


def test_masking_by_multiplication_would_inflate():
    """The control: what other harnesses do gives 10 log10(1 / share) too much."""
    target = photo()
    image = spoiled(target, 0.05)
    mask = torch.zeros(400, 600, dtype=torch.bool)
    mask[:, :300] = True
    right = psnr(image, target, mask)
    multiplied = psnr(image * mask[..., None], target * mask[..., None])
    assert multiplied - right == pytest.approx(10 * math.log10(2), abs=1e-6)


def test_psnr_of_mse():
    assert psnr_of_mse(0.01) == pytest.approx(20)
    assert psnr_of_mse(0.0) == math.inf
    assert math.isnan(psnr_of_mse(math.nan))
