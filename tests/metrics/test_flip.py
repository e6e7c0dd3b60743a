"""FLIP against the paper's formulas, and its own properties."""

import math

import flip_evaluator
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.flip_formula import flip_formula
from helpers.images import noise_image, pairs, photo, random_mask, spoiled
from splatproof.metrics.ldr_flip import flip, flip_map
from splatproof.metrics.pairs import check_pair

FLOAT32 = 2e-4
"""flip-evaluator filters in float32 and takes roots of small differences; measured: 4e-5."""


@pytest.mark.parametrize("blur", [0.0, 1.0, 3.0])
def test_agrees_with_the_formulas_of_the_paper(blur):
    crop = photo()[150:230, 250:350]
    image = spoiled(crop, 0.02, blur=blur)
    want = flip_formula(crop.double().numpy(), image.double().numpy())
    got = flip_map(check_pair(image, crop))
    assert np.abs(got - want).max() < FLOAT32
    assert flip(image, crop) == pytest.approx(want.mean(), abs=FLOAT32 / 10)


def test_the_formula_tells_viewing_conditions_apart(monkeypatch):
    """The control: at half the pixels per degree the oracle no longer agrees."""
    crop = photo()[150:230, 250:350]
    image = spoiled(crop, 0.02, blur=1.0)
    monkeypatch.setattr("helpers.flip_formula.PIXELS_PER_DEGREE", 33.5)
    want = flip_formula(crop.double().numpy(), image.double().numpy())
    assert abs(flip(image, crop) - want.mean()) > 100 * FLOAT32


@given(pairs())
def test_properties(pair):
    image, target = pair
    assert flip(target, target) == 0
    assert 0 <= flip(image, target) <= 1
    assert flip(image, target) == pytest.approx(flip(target, image), abs=1e-6)
    everything = torch.ones(image.shape[:2], dtype=torch.bool)
    assert flip(image, target, everything) == flip(image, target)


def test_more_noise_is_worse():
    target = photo()[:100, :120]
    values = [flip(spoiled(target, sigma), target) for sigma in (0.01, 0.03, 0.1)]
    assert values == sorted(values)
    assert len(set(values)) == 3


@settings(max_examples=20)
@given(share=st.floats(0.1, 0.95), seed=st.integers(0, 99))
def test_what_the_mask_hides_cannot_matter(share, seed):
    target = noise_image(30, 40, seed)
    image = spoiled(target, 0.1, seed)
    mask = random_mask(30, 40, share, seed + 1)
    before = flip(image, target, mask)
    image[~mask], target[~mask] = math.nan, 7.0
    assert flip(image, target, mask) == before


def test_a_mask_averages_the_map_over_valid_pixels():
    target = noise_image(30, 40, 0)
    image = target.clone()
    image[:, :20] = 1 - image[:, :20]
    left = torch.zeros(30, 40, dtype=torch.bool)
    left[:, :20] = True
    far_right = torch.zeros(30, 40, dtype=torch.bool)
    far_right[:, 20:] = True
    assert flip(image, target, far_right) == 0
    assert flip(image, target, left) > 1.5 * flip(image, target)


def test_no_valid_pixel_is_nan():
    image = noise_image(5, 6, 0)
    assert math.isnan(flip(image, 1 - image, torch.zeros(5, 6, dtype=torch.bool)))


def test_a_map_is_made_once_for_the_same_pixels(monkeypatch):
    made = []
    evaluate = flip_evaluator.evaluate
    monkeypatch.setattr(
        flip_evaluator, "evaluate", lambda *a, **k: made.append(a) or evaluate(*a, **k)
    )
    target = noise_image(20, 30, 5)
    image = spoiled(target, 0.1, 6)
    first = flip_map(check_pair(image, target))
    first[:] = 0  # who gets a map may write on it
    assert flip(image.clone(), target.clone()) > 0
    assert len(made) == 1
    image[3, 4, 1] = 1 - image[3, 4, 1]
    flip(image, target)
    flip(target, image)  # the reverse is another pair
    assert len(made) == 3
