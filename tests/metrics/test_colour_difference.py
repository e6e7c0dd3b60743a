"""Colour differences against scikit-image, published pairs and the formula in float64."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from skimage.color import deltaE_ciede2000, rgb2lab

from helpers.images import noise_image, pairs, random_mask, spoiled
from splatproof.metrics.colour_difference import delta_e_76, delta_e_2000

BOTH = pytest.mark.parametrize("metric", [delta_e_76, delta_e_2000])
SHARMA = (
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0),
    ((50, -1, 2), (50, 0, 0), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (61, -5, 29), 22.8977),
    ((50, 2.5, 0), (56, -27, -3), 31.9030),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
)
"""Pairs of Sharma et al. 2005, Table 1, with their difference."""


def ciede2000(one, other):
    """The formula, in the order of the paper's equations."""
    chroma = [math.hypot(a, b) for _, a, b in (one, other)]
    mean7 = (sum(chroma) / 2) ** 7
    g = 0.5 * (1 - math.sqrt(mean7 / (mean7 + 25.0**7)))
    a = [(1 + g) * colour[1] for colour in (one, other)]
    b = [colour[2] for colour in (one, other)]
    c = [math.hypot(*ab) for ab in zip(a, b, strict=True)]
    h = [math.degrees(math.atan2(y, x)) % 360 for x, y in zip(a, b, strict=True)]
    turn = (h[1] - h[0] + 180) % 360 - 180 if c[0] * c[1] else 0.0
    if h[1] - h[0] == 180:
        turn = 180.0  # the paper's choice of the two halves
    d_l, d_c = other[0] - one[0], c[1] - c[0]
    d_h = 2 * math.sqrt(c[0] * c[1]) * math.sin(math.radians(turn / 2))
    light, c_mean = (one[0] + other[0]) / 2, sum(c) / 2
    if not c[0] * c[1]:
        hue = sum(h)
    elif abs(h[0] - h[1]) <= 180:
        hue = sum(h) / 2
    else:
        hue = (sum(h) + (360 if sum(h) < 360 else -360)) / 2

    def cos(degrees):
        return math.cos(math.radians(degrees))

    t = 1 - 0.17 * cos(hue - 30) + 0.24 * cos(2 * hue) + 0.32 * cos(3 * hue + 6)
    t -= 0.20 * cos(4 * hue - 63)
    theta = 30 * math.exp(-(((hue - 275) / 25) ** 2))
    r_c = 2 * math.sqrt(c_mean**7 / (c_mean**7 + 25.0**7))
    s_l = 1 + 0.015 * (light - 50) ** 2 / math.sqrt(20 + (light - 50) ** 2)
    s_c, s_h = 1 + 0.045 * c_mean, 1 + 0.015 * c_mean * t
    r_t = -math.sin(math.radians(2 * theta)) * r_c
    x, y, z = d_l / s_l, d_c / s_c, d_h / s_h
    return math.sqrt(x * x + y * y + z * z + r_t * y * z)


@pytest.mark.parametrize(("one", "other", "want"), SHARMA)
def test_the_formula_gives_the_published_differences(one, other, want):
    assert ciede2000(one, other) == pytest.approx(want, abs=5e-5)  # printed with four digits
    assert float(deltaE_ciede2000(np.array(one), np.array(other))) == pytest.approx(want, abs=5e-5)


@settings(max_examples=20)
@given(pairs(largest=16))
def test_they_agree_with_scikit_images_lab_and_the_formula(pair):
    image, target = (rgb2lab(x.double().numpy()) for x in pair)
    # a cube root, a few products: float64 to 1e-13 of 100, measured 1.2e-13
    straight = np.sqrt(((image - target) ** 2).sum(axis=2)).mean()
    assert delta_e_76(*pair) == pytest.approx(straight, abs=1e-11)
    colours = zip(image.reshape(-1, 3), target.reshape(-1, 3), strict=True)
    want = np.mean([ciede2000(tuple(one), tuple(other)) for one, other in colours])
    # the hue of a nearly grey colour turns with its last digits, and weighs as little as its chroma
    assert delta_e_2000(*pair) == pytest.approx(want, abs=1e-6)


def test_colours_that_everyone_knows():
    black, white, red, green = (
        torch.tensor(c).expand(1, 1, 3) for c in ([0.0] * 3, [1.0] * 3, [1.0, 0, 0], [0, 1.0, 0])
    )
    # white is at (100, 0, 0) up to the six digits of the matrix, black at the origin
    assert delta_e_76(white, black) == pytest.approx(100, abs=1e-2)
    assert delta_e_2000(white, black) == pytest.approx(100, abs=1e-2)
    # Lab of red (53.24, 80.09, 67.20) and green (87.73, -86.18, 83.18), as tables print them
    assert delta_e_76(red, green) == pytest.approx(170.56, abs=2e-2)
    assert delta_e_76(red, green[..., [2, 0, 1]]) != pytest.approx(170.56, abs=2e-2)


@BOTH
def test_only_valid_pixels_count(metric):
    target = noise_image(12, 15, 1)
    image, mask = spoiled(target, 0.1), random_mask(12, 15, 0.5, 2)
    want = metric(image[mask][None], target[mask][None])
    image[~mask], target[~mask] = math.nan, 7.0
    assert metric(image, target, mask) == pytest.approx(want, rel=1e-12)
    assert math.isnan(metric(image, target, torch.zeros_like(mask)))


@BOTH
def test_it_is_symmetric(metric):
    one, other = noise_image(9, 8, 1), noise_image(9, 8, 2)
    assert metric(one, other) == pytest.approx(metric(other, one), rel=1e-9)
