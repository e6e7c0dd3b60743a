"""What every registered metric must do, whatever it measures."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.images import noise_image, random_mask, spoiled
from splatproof.base.errors import DataError, UsageError
from splatproof.metrics.registry import BUILT_IN, find_metric, load_weights

WINDOWS = {
    "ssim_3dgs": 11, "ssim_valid": 11, "ssim_skimage": 7, "ssim_kornia": 11, "ms_ssim_kornia": 33,
    "ssim_contrast": 11,
}  # fmt: skip
WITHOUT_WEIGHTS = [metric for metric in BUILT_IN.values() if metric.load_weights is None]
ALL = pytest.mark.parametrize("metric", WITHOUT_WEIGHTS, ids=lambda metric: metric.name)


def test_each_is_under_its_own_name():
    assert all(name == metric.name for name, metric in BUILT_IN.items())
    assert all(metric.source for metric in BUILT_IN.values())
    learned = {name for name, metric in BUILT_IN.items() if metric.load_weights}
    assert learned == {"lpips_vgg_m11", "lpips_alex_m11", "lpips_vgg_01"}


@ALL
@settings(max_examples=10)
@given(seed=st.integers(0, 999), sigma=st.floats(0.001, 0.5), masked=st.booleans())
def test_stays_in_its_range_and_points_the_right_way(metric, seed, sigma, masked):
    target = noise_image(45, 40, seed)
    mask = random_mask(45, 40, 0.9, seed) if masked else None
    near, far = (spoiled(target, s, seed) for s in (sigma / 10, sigma))
    values = [metric.function(image, target, mask) for image in (near, far)]
    low, high = metric.range
    if not any(math.isnan(value) for value in values):  # no whole window
        assert all(low <= value <= high for value in values)
        assert (values[0] > values[1]) == metric.higher_is_better


@ALL
def test_the_best_value_is_that_of_equal_images(metric):
    image = noise_image(40, 50, 0)
    best = metric.range[1] if metric.higher_is_better else metric.range[0]
    assert metric.function(image, image, None) == pytest.approx(best, abs=1e-9)


@ALL
def test_arguments_are_left_as_they_were(metric):
    target = noise_image(40, 50, 0)
    image = spoiled(target, 0.1)
    mask = random_mask(40, 50, 0.8, 1)
    before = image.clone(), target.clone(), mask.clone()
    metric.function(image, target, mask)
    assert all(torch.equal(a, b) for a, b in zip(before, (image, target, mask), strict=True))


@ALL
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -0.001, 1.001])
@pytest.mark.parametrize("which", ["image", "target"])
def test_a_bad_pixel_is_refused_with_where(metric, bad, which):
    images = {"image": noise_image(40, 50, 0), "target": noise_image(40, 50, 1)}
    images[which][12, 34, 1] = bad
    images[which][13, 1, 2] = bad
    message = rf"{metric.name}: {which}: \S+ in G at row 12, column 34 \(2 such pixels\)"
    with pytest.raises(DataError, match=message):
        metric.function(*images.values(), None)


@ALL
def test_different_sizes_are_refused(metric):
    image = noise_image(40, 50, 0)
    with pytest.raises(DataError, match="image is 50 x 40 px but target is 49 x 40 px"):
        metric.function(image, image[:, :49], None)
    with pytest.raises(DataError, match="image is 50 x 40 px but mask is 50 x 39 px"):
        metric.function(image, image, torch.ones(39, 50, dtype=torch.bool))


@ALL
@pytest.mark.parametrize("size", [(1, 1), (1, 200), (200, 1)])
def test_tiny_images_are_scored_or_refused_with_the_window(metric, size):
    image = noise_image(size[0], size[1], 0)
    if metric.name in WINDOWS:
        side = WINDOWS[metric.name]
        with pytest.raises(DataError, match=f"{metric.name}: .*smaller .* {side} x {side} px"):
            metric.function(image, image, None)
    else:
        assert math.isfinite(metric.function(1 - image, image, None))


@pytest.mark.parametrize("name", WINDOWS)
def test_the_window_itself_is_large_enough(name):
    side = WINDOWS[name]
    image = noise_image(side, side, 0)
    assert BUILT_IN[name].function(image, image, None) == pytest.approx(1, abs=1e-9)
    with pytest.raises(DataError, match="smaller"):
        BUILT_IN[name].function(image[1:], image[1:], None)


@ALL
def test_no_pixels_are_refused(metric):
    with pytest.raises(DataError, match="smaller"):
        metric.function(torch.zeros(0, 50, 3), torch.zeros(0, 50, 3), None)


def test_metrics_without_weights_have_nothing_to_load():
    assert load_weights([metric.name for metric in WITHOUT_WEIGHTS]) == {}
    with pytest.raises(UsageError, match="metric: unknown 'psrn'"):
        load_weights(["psrn"])


def test_an_unknown_name_is_refused_with_the_nearest():
    assert find_metric("psnr") is BUILT_IN["psnr"]
    with pytest.raises(UsageError, match="metric: unknown 'psrn', did you mean 'psnr'"):
        find_metric("psrn")
