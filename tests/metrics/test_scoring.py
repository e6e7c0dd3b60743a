"""Preparing, scoring and averaging images by a protocol's rules."""

import dataclasses
import hashlib
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.images import noise_image, pairs, random_mask, spoiled
from splatproof.base.errors import DataError
from splatproof.metrics.pixel import psnr
from splatproof.metrics.registry import BUILT_IN
from splatproof.metrics.scoring import (
    prepare,
    region_columns,
    round_to_8_bit,
    scene_metrics,
    score_image,
)
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore

ROUND = Protocol(name="test", source="ours")


def with_rules(**rules) -> Protocol:
    return dataclasses.replace(ROUND, **rules)


def test_scores_are_those_of_the_prepared_images():
    truth = noise_image(40, 50, 0)
    render = truth + 0.1 * torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    mask = random_mask(40, 50, 0.9, 1)
    score = score_image("a.png", render, truth, ROUND, mask)
    eight_bit = torch.from_numpy(np.floor(render.clamp(0, 1).numpy() * 255 + 0.5) / 255)
    assert score.metrics == {
        name: BUILT_IN[name].function(eight_bit, truth, mask) for name in ROUND.metrics
    }
    assert score.valid_share == float(mask.double().mean())
    assert score.name == "a.png"
    assert score.truth_sha256 == hashlib.sha256(truth.numpy().tobytes()).hexdigest()


@given(pairs())
def test_values_outside_are_clamped_before_anything_else(pair):
    image, truth = pair
    wild = torch.where(image > 0.5, image + 9, image - 9)
    tame = (image > 0.5).float()
    rules = with_rules(metrics=("psnr", "l1"), rounding="float")
    assert score_image("a", wild, truth, rules) == score_image("a", tame, truth, rules)


@pytest.mark.parametrize("region", ["full", "right_half"])
@pytest.mark.parametrize("rounding", ["round", "truncate", "float"])
@pytest.mark.parametrize("masked", [True, False])
def test_preparing_twice_changes_nothing(region, rounding, masked):
    truth, render = noise_image(9, 12, 0), noise_image(9, 12, 1)
    mask = random_mask(9, 12, 0.7, 2)
    rules = with_rules(region=region, rounding=rounding, masked=masked)
    once = prepare(render, truth, rules, mask)
    twice = prepare(once.render, once.truth, with_rules(rounding=rounding), once.mask)
    assert torch.equal(once.render, twice.render)
    assert torch.equal(once.truth, truth[:, region_columns(12, region)])


@pytest.mark.parametrize("rounding", ["round", "truncate"])
def test_a_saved_image_survives_both_roundings(rounding):
    """Every k / 255 in float32 stays k / 255: floor(255 (k / 255)) must not lose one."""
    saved = (torch.arange(256, dtype=torch.float32) / 255)[:, None, None].expand(256, 1, 3)
    assert torch.equal(round_to_8_bit(saved, rounding), saved)


@given(st.floats(0, 1, width=32))
def test_rounding_goes_to_the_nearest_and_truncation_down(value):
    pixel = torch.full((1, 1, 3), value)
    rounded = float(round_to_8_bit(pixel, "round")[0, 0, 0] * 255)
    truncated = float(round_to_8_bit(pixel, "truncate")[0, 0, 0] * 255)
    eps = 255 * 2.0**-23  # of the float32 product 255 x
    assert abs(rounded - 255 * value) <= 0.5 + eps
    assert -eps <= 255 * value - truncated < 1 + eps
    assert rounded - truncated in (0, 1)


def test_half_goes_up():
    """99.99 / 255 rounds to 100 and truncates to 99; exactly half goes up, not to even."""
    values = torch.tensor([99.99, 0.5, 1.5, 2.5, 254.5]) / 255
    image = values[:, None, None].expand(5, 1, 3)
    assert (round_to_8_bit(image, "round")[:, 0, 0] * 255).round().tolist() == [100, 1, 2, 3, 255]
    assert (round_to_8_bit(image, "truncate")[:, 0, 0] * 255).round().tolist() == [99, 0, 1, 2, 254]


@given(st.integers(1, 99))
def test_on_odd_widths_the_middle_column_belongs_to_neither_half(width):
    columns = list(range(width))
    right = columns[region_columns(width, "right_half")]
    left = columns[: width // 2]
    assert len(left) == len(right)
    assert not set(left) & set(right)
    assert width - len(left) - len(right) == width % 2
    assert columns[region_columns(width, "full")] == columns


@pytest.mark.parametrize(("width", "scored"), [(4, [2, 3]), (5, [3, 4]), (2, [1])])
def test_right_half_by_number(width, scored):
    truth = torch.arange(width, dtype=torch.float32).expand(3, width)[..., None].expand(3, width, 3)
    ready = prepare(truth / 255, truth / 255, with_rules(region="right_half"))
    assert (ready.truth[0, :, 0] * 255).round().int().tolist() == scored


def test_what_is_left_of_the_region_cannot_matter():
    truth, render = noise_image(40, 51, 0), noise_image(40, 51, 1)
    rules = with_rules(region="right_half")
    before = score_image("a", render, truth, rules)
    render[:, :26] = 0
    assert score_image("a", render, truth, rules) == before
    render[:, 26:27] = 1 - render[:, 26:27]
    assert score_image("a", render, truth, rules) != before


def test_the_hash_follows_the_region_but_not_the_render():
    truth = noise_image(40, 50, 0)
    full = score_image("a", truth, truth, ROUND).truth_sha256
    assert score_image("a", 1 - truth, truth, ROUND).truth_sha256 == full
    assert score_image("a", truth, truth, with_rules(region="right_half")).truth_sha256 != full
    other = truth.clone()
    other[3, 4, 1] += 2.0**-23 if other[3, 4, 1] < 0.5 else -(2.0**-23)
    assert score_image("a", truth, other, ROUND).truth_sha256 != full


def test_an_unmasked_protocol_ignores_the_mask():
    truth, render = noise_image(40, 50, 0), noise_image(40, 50, 1)
    mask = random_mask(40, 50, 0.5, 2)
    rules = with_rules(masked=False)
    assert score_image("a", render, truth, rules, mask) == score_image("a", render, truth, rules)
    assert score_image("a", render, truth, ROUND, mask) != score_image("a", render, truth, ROUND)
    assert score_image("a", render, truth, rules, mask).valid_share == 1


def test_valid_share_is_that_of_the_region():
    truth = noise_image(40, 50, 0)
    mask = torch.ones(40, 50, dtype=torch.bool)
    mask[:, :25] = False
    assert score_image("a", truth, truth, ROUND, mask).valid_share == 0.5
    rules = with_rules(region="right_half")
    assert score_image("a", truth, truth, rules, mask).valid_share == 1


def test_colour_fits_are_extra_columns():
    truth = 0.2 + 0.6 * noise_image(40, 50, 0)
    render = 0.5 * truth + 0.1
    plain = score_image("a", render, truth, ROUND)
    fitted = score_image("a", render, truth, with_rules(colour_fit=("cc_affine", "cc_quadratic")))
    assert plain.metrics.items() <= fitted.metrics.items()
    extra = list(fitted.metrics)[len(plain.metrics) :]
    assert extra == [f"{k}_{m}" for k in ("cc_affine", "cc_quadratic") for m in ROUND.metrics]
    # 8-bit rounding of a render of half the contrast leaves 1 / sqrt(12) / 255 * 2: 52.9 dB.
    assert fitted.metrics["cc_affine_psnr"] == pytest.approx(52.9, abs=0.3)
    assert fitted.metrics["psnr"] < 20


NAN = noise_image(40, 50, 1)
NAN[7, 3, 0] = math.nan


@pytest.mark.parametrize(
    ("render", "truth", "mask", "rules", "message"),
    [
        (NAN, noise_image(40, 50, 0), None, {}, "a.png: render: nan in R at row 7, column 3"),
        (noise_image(40, 50, 0), NAN, None, {}, "a.png: truth: nan in R at row 7, column 3"),
        (noise_image(40, 50, 0), 2 * noise_image(40, 50, 0), None, {}, "a.png: truth: .*0, 1"),
        (noise_image(40, 50, 0), noise_image(50, 40, 0), None, {}, "a.png: render is 50 x 40 .*40"),
        (
            noise_image(40, 50, 0),
            noise_image(40, 50, 0),
            torch.ones(2, 2, dtype=torch.bool),
            {},
            "a.png: render is 50 x 40 px but mask is 2 x 2 px",
        ),
        (
            noise_image(40, 50, 0),
            noise_image(40, 50, 0),
            torch.zeros(40, 50, dtype=torch.bool),
            {},
            "a.png: no valid pixel",
        ),
        (
            noise_image(40, 1, 0),
            noise_image(40, 1, 0),
            None,
            {"region": "right_half"},
            "a.png: no valid pixel in the region 'right_half'",
        ),
        (
            noise_image(40, 20, 0),
            noise_image(40, 20, 0),
            None,
            {"region": "right_half"},
            "a.png: ssim_3dgs: image is 10 x 40 px, smaller than .* 11 x 11 px window",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(render, truth, mask, rules, message):
    with pytest.raises(DataError, match=message) as caught:
        score_image("a.png", render, truth, with_rules(**rules), mask)
    assert "\n" not in str(caught.value)


def test_bad_pixels_under_the_mask_do_no_harm():
    truth = noise_image(40, 50, 0)
    mask = torch.ones(40, 50, dtype=torch.bool)
    mask[7, 3] = False
    assert math.isfinite(score_image("a", NAN, truth, ROUND, mask).metrics["psnr"])


def image_score(name: str, **metrics: float) -> ImageScore:
    return ImageScore(name=name, truth_sha256="", valid_share=1.0, metrics=metrics)


def test_a_scene_is_the_mean_of_its_images():
    """20 and 26 dB: mean 23; MSEs 0.01 and 0.002512 average to 22.04 dB."""
    images = [image_score("a", psnr=20.0, flip=0.25), image_score("b", psnr=26.0, flip=0.75)]
    assert scene_metrics(images) == {
        "psnr": 23.0,
        "flip": 0.5,
        "psnr_of_mean_mse": pytest.approx(-10 * math.log10((0.01 + 10**-2.6) / 2), abs=1e-12),
    }
    assert scene_metrics(iter(images)) == scene_metrics(images)


@given(st.integers(1, 5), st.integers(0, 99))
def test_psnr_of_mean_mse_is_that_of_the_stacked_images(count, seed):
    truths = [noise_image(12, 12, seed + i) for i in range(count)]
    renders = [spoiled(t, 0.05 * (i + 1), seed) for i, t in enumerate(truths)]
    rules = with_rules(rounding="float", metrics=("psnr",))
    got = scene_metrics(
        score_image(str(i), r, t, rules)
        for i, (r, t) in enumerate(zip(renders, truths, strict=True))
    )
    assert got["psnr_of_mean_mse"] == pytest.approx(psnr(torch.cat(renders), torch.cat(truths)))
    assert got["psnr"] == pytest.approx(
        np.mean([psnr(r, t) for r, t in zip(renders, truths, strict=True)])
    )
    assert got["psnr_of_mean_mse"] <= got["psnr"] + 1e-9  # Jensen


def test_inf_and_nan_are_not_hidden():
    perfect = scene_metrics([image_score("a", psnr=math.inf), image_score("b", psnr=20.0)])
    assert perfect["psnr"] == math.inf
    assert perfect["psnr_of_mean_mse"] == pytest.approx(10 * math.log10(200))
    undefined = scene_metrics([image_score("a", psnr=math.nan), image_score("b", psnr=20.0)])
    assert math.isnan(undefined["psnr"])
    assert math.isnan(undefined["psnr_of_mean_mse"])


def test_each_fitted_psnr_is_pooled_under_its_own_name():
    got = scene_metrics([image_score("a", psnr=20.0, cc_affine_psnr=30.0)])
    assert got["cc_affine_psnr_of_mean_mse"] == pytest.approx(30)


def test_no_mean_without_images_or_over_different_metrics():
    with pytest.raises(DataError, match="no image was scored"):
        scene_metrics([])
    with pytest.raises(DataError, match="b has the metrics flip but a has psnr"):
        scene_metrics([image_score("a", psnr=20.0), image_score("b", flip=0.1)])
