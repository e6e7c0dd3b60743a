"""SSIM's contrast term against its definition, and what it sees that SSIM and PSNR do not."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from helpers.images import noise_image, pairs, photo, random_mask, spoiled
from splatproof.metrics.pixel import psnr
from splatproof.metrics.ssim import C2, ssim_contrast, ssim_valid

ROUNDING = 1e-6
"""Of a variance near 0 the root is taken, so 1e-16 becomes 1e-8: times 2 sx over sx^2 + C2, at most 33, 3e-7."""


def slow_contrast(image, target):
    """Mean over whole windows of Wang et al. 2004, Eq. 9, by weighted deviations."""
    offsets = np.arange(11) - 5
    line = np.exp(-(offsets**2) / (2 * 1.5**2))
    weights = np.outer(line, line) / line.sum() ** 2
    found = []
    for i in range(image.shape[0] - 10):
        for j in range(image.shape[1] - 10):
            for c in range(3):
                sx, sy = (
                    ((weights * (p - (weights * p).sum()) ** 2).sum()) ** 0.5
                    for p in (
                        a[i : i + 11, j : j + 11, c].double().numpy() for a in (image, target)
                    )
                )
                found.append((2 * sx * sy + C2) / (sx**2 + sy**2 + C2))
    return float(np.mean(found))


@settings(max_examples=10)
@given(pairs(smallest=11, largest=16))
def test_agrees_with_the_slow_formula(pair):
    assert ssim_contrast(*pair) == pytest.approx(slow_contrast(*pair), abs=ROUNDING)


@settings(max_examples=20)
@given(pairs(smallest=11, largest=40))
def test_symmetric_bounded_and_never_below_ssim(pair):
    """Structure and luminance only lower it: both are at most 1."""
    image, target = pair
    found = ssim_contrast(image, target)
    assert 0 <= found <= 1 + 1e-12
    assert found == pytest.approx(ssim_contrast(target, image), abs=ROUNDING)
    assert found >= ssim_valid(image, target) - ROUNDING
    assert ssim_contrast(image, image) == pytest.approx(1)


def test_a_smear_is_seen_and_detail_that_stands_elsewhere_is_not():
    """Noise moved by 20 pixels: PSNR and SSIM prefer its blur, the contrast term the moved one."""
    target = noise_image(60, 80, 0)
    moved = torch.roll(target, 20, dims=1)
    smear = torch.from_numpy(gaussian_filter(target.numpy(), (6, 6, 0)))
    assert psnr(smear, target) > psnr(moved, target) + 2
    assert ssim_valid(smear, target) > ssim_valid(moved, target)
    assert ssim_contrast(moved, target) > 0.95
    assert ssim_contrast(smear, target) < 0.5


@pytest.mark.parametrize("amount", [0.1, 0.3])
def test_noise_is_no_detail(amount):
    target = photo()[:120, :120] * 0.5 + 0.25
    worse = spoiled(target, amount)
    assert ssim_contrast(worse, target) < 0.95


@given(level=st.floats(0, 1), other=st.floats(0, 1))
def test_flat_images_have_equal_contrasts(level, other):
    flat = torch.full((15, 15, 3), level)
    assert ssim_contrast(flat, torch.full((15, 15, 3), other)) == pytest.approx(1, abs=1e-6)


def test_a_mask_means_windows_that_are_fully_valid():
    target = noise_image(50, 60, 3)
    image = spoiled(target, 0.1)
    mask = torch.zeros(50, 60, dtype=torch.bool)
    mask[10:40, 15:50] = True
    crop = (slice(10, 40), slice(15, 50))
    assert ssim_contrast(image, target, mask) == pytest.approx(
        ssim_contrast(image[crop], target[crop]), abs=ROUNDING
    )
    odd = random_mask(50, 60, 0.995, 1)
    before = ssim_contrast(image, target, odd)
    image[~odd], target[~odd] = math.nan, 7.0
    assert ssim_contrast(image, target, odd) == before
    assert math.isnan(ssim_contrast(image, target, torch.zeros_like(mask)))
