"""Differences of gradients against scipy's Sobel filters."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from scipy.ndimage import gaussian_filter, sobel

from helpers.images import noise_image, pairs, photo, random_mask, spoiled
from splatproof.metrics.gradient import LARGEST, gradient_l1, magnitude


def lengths(image):
    """Gradient magnitudes by scipy: its Sobel filters are eight times kornia's."""
    channels = [
        np.hypot(*(sobel(values, axis=axis, mode="nearest") / 8 for axis in (0, 1)))
        for values in np.moveaxis(image.double().numpy(), 2, 0)
    ]
    return np.stack(channels, axis=2)


@given(pairs())
def test_it_agrees_with_scipys_sobel(pair):
    want = np.abs(lengths(pair[0]) - lengths(pair[1])).mean()
    # a difference of sums of six products of numbers in [0, 1]: float64 to 1e-15
    assert gradient_l1(*pair) == pytest.approx(want, abs=1e-14)


def test_a_ramp_and_an_edge():
    ramp = torch.arange(9.0).expand(6, 9)[..., None].repeat(1, 1, 3) / 100
    flat = torch.zeros(6, 9, 3)
    # 1/100 a pixel inside, half of it in the two border columns, whose neighbour is repeated
    assert gradient_l1(ramp, flat) == pytest.approx((7 * 0.01 + 2 * 0.005) / 9, rel=1e-6)
    edge = flat.clone()
    edge[:, 4:] = 1
    assert gradient_l1(edge, flat) == pytest.approx(2 * 0.5 / 9)
    assert magnitude(edge.double().numpy()).max() == 0.5 < LARGEST


def test_blur_is_seen_and_a_shift_of_brightness_is_not():
    target = 0.1 + 0.8 * photo()
    blurred = torch.from_numpy(gaussian_filter(target.numpy(), (1.5, 1.5, 0)))
    assert gradient_l1(blurred, target) > 0.01
    assert gradient_l1(target + 0.05, target) == pytest.approx(0, abs=1e-7)  # float32 images


def test_a_mask_means_windows_that_are_fully_valid():
    target = noise_image(20, 25, 3)
    image, mask = spoiled(target, 0.1), torch.zeros(20, 25, dtype=torch.bool)
    mask[4:12, 5:17] = True
    inner = (slice(5, 11), slice(6, 16))
    want = np.abs(lengths(image) - lengths(target))[inner].mean()
    assert gradient_l1(image, target, mask) == pytest.approx(want, abs=1e-14)
    odd = random_mask(20, 25, 0.9, 1)
    before = gradient_l1(image, target, odd)
    image[~odd], target[~odd] = math.nan, 7.0
    assert gradient_l1(image, target, odd) == before
    assert math.isnan(gradient_l1(image, target, torch.zeros_like(mask)))
