"""Metrics over what moves and what does not: each looks at its own pixels and at no others."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity

from splatproof.metrics.parts import OVER, PARTS, part_key, parts_of, score_part
from splatproof.metrics.pixel import psnr
from splatproof.metrics.registry import BUILT_IN
from splatproof.metrics.scoring import scene_metrics, score_image
from splatproof.reference.types.protocol import Protocol
from splatproof.reports.columns import score_column

RULES = Protocol(
    name="drive", source="test", rounding="float", metrics=("psnr", "ssim_skimage"), parts=PARTS
)
H, W = 24, 32


def images(seed):
    generator = torch.Generator().manual_seed(seed)
    truth = torch.rand(H, W, 3, generator=generator)
    noise = 0.2 * torch.randn(H, W, 3, generator=generator)
    return (truth + noise).clamp(0, 1), truth


def movers(seed):
    """A person before a vehicle: the two masks may share pixels, as rectangles around boxes do."""
    rng = np.random.default_rng(seed)
    masks = {}
    for kind in ("vehicles", "people"):
        mask = torch.zeros(H, W, dtype=torch.bool)
        y, x = int(rng.integers(0, 12)), int(rng.integers(0, 16))
        mask[y : y + int(rng.integers(1, 12)), x : x + int(rng.integers(1, 16))] = True
        masks[kind] = mask
    return masks


@given(seed=st.integers(0, 2**16))
@settings(max_examples=40)
def test_moving_and_still_make_up_the_image(seed):
    image, truth = images(seed)
    parts = parts_of(movers(seed))
    assert parts.keys() == set(PARTS)
    assert torch.equal(parts["moving"], parts["vehicles"] | parts["people"])
    shares = {name: float(parts[name].double().mean()) for name in ("moving", "still")}
    assert sum(shares.values()) == pytest.approx(1)
    for metric, back in (("psnr", lambda v: 10 ** (-v / 10)), ("l1", float), ("flip", float)):
        whole = back(BUILT_IN[metric].function(image, truth, None))
        own = [
            shares[name] * back(score_part(metric, image, truth, None, parts[name]))
            for name in shares
        ]
        assert sum(own) == pytest.approx(whole, rel=1e-9)


@given(seed=st.integers(0, 2**16))
@settings(max_examples=20)
def test_as_the_release_of_omnire_computes_them(seed):
    """PSNR of the chosen pixels; SSIM's map of the whole image, averaged over them."""
    image, truth = images(seed)
    part = movers(seed)["people"]
    chosen = part.numpy()
    mse = ((image.double().numpy() - truth.double().numpy())[chosen] ** 2).mean()
    assert score_part("psnr", image, truth, None, part) == pytest.approx(-10 * math.log10(mse))
    full = structural_similarity(
        image.double().numpy(), truth.double().numpy(), data_range=1.0, channel_axis=-1, full=True
    )[1]
    want = full[chosen].mean()
    assert score_part("ssim_skimage", image, truth, None, part) == pytest.approx(want, abs=1e-12)


@pytest.mark.parametrize("metric", OVER)
def test_other_pixels_do_not_matter_but_to_windows(metric):
    image, truth = images(3)
    part = torch.zeros(H, W, dtype=torch.bool)
    part[8:13, 8:13] = True
    before = score_part(metric, image, truth, None, part)
    image[:, 30:] = 1 - image[:, 30:]  # further off than any window but FLIP's reaches
    after = score_part(metric, image, truth, None, part)
    assert after == (before if metric != "flip" else pytest.approx(before, rel=0.1))
    image[10, 10] = 1 - truth[10, 10]
    assert score_part(metric, image, truth, None, part) != after  # the check can fail
    assert math.isnan(score_part(metric, image, truth, None, torch.zeros_like(part)))
    assert math.isnan(score_part(metric, image, truth, ~part, part))  # invalid pixels do not count


def test_psnr_over_a_part_is_psnr_under_a_mask():
    image, truth = images(4)
    part, valid = movers(4)["vehicles"], torch.rand(H, W) > 0.3
    assert score_part("psnr", image, truth, valid, part) == psnr(image, truth, valid & part)


def test_columns_of_an_image_and_means_over_the_images_that_have_the_part():
    scores = []
    for seed in range(3):
        masks = movers(seed)
        if seed == 1:
            masks["people"] = torch.zeros(H, W, dtype=torch.bool)
        scores.append(score_image(f"{seed}.png", *images(seed), RULES, None, masks))
    assert list(scores[0].metrics) == [
        *RULES.metrics, *(part_key(part, m) for part in PARTS for m in RULES.metrics),
    ]  # fmt: skip
    assert math.isnan(scores[1].metrics["people_psnr"])
    means = scene_metrics(scores)
    own = [scores[i].metrics["people_psnr"] for i in (0, 2)]
    assert means["people_psnr"] == pytest.approx(sum(own) / 2)
    assert "people_psnr_of_mean_mse" not in means
    plain = Protocol(name="p", source="test", rounding="float", metrics=RULES.metrics)
    whole = [score_image(f"{seed}.png", *images(seed), plain) for seed in range(3)]
    assert [one.metrics["psnr"] for one in whole] == [one.metrics["psnr"] for one in scores]
    assert "moving_psnr" not in whole[0].metrics


def test_what_is_not_known_is_nan_and_never_spoils_the_rest():
    known = score_image("a.png", *images(0), RULES, None, movers(0))
    unknown = score_image("b.png", *images(1), RULES, None, {})
    assert math.isnan(unknown.metrics["still_psnr"])
    means = scene_metrics([known, unknown])
    assert means["still_psnr"] == known.metrics["still_psnr"]
    assert math.isnan(scene_metrics([unknown])["still_psnr"])
    assert means["psnr"] == pytest.approx((known.metrics["psnr"] + unknown.metrics["psnr"]) / 2)


def test_the_half_that_is_scored_is_the_half_of_the_parts():
    image, truth = images(5)
    rules = Protocol(
        name="p", source="test", rounding="float", metrics=("psnr",), parts=("moving",),
        region="right_half",
    )  # fmt: skip
    part = torch.zeros(H, W, dtype=torch.bool)
    part[4:10, 10:20] = True
    got = score_image("a", image, truth, rules, None, {"vehicles": part, "people": part & False})
    right = part.clone()
    right[:, : W // 2] = False
    assert got.metrics["moving_psnr"] == psnr(image, truth, right)


def test_tables_know_the_unit_of_a_part():
    column = score_column("moving_psnr", per_image=True)
    assert (column.unit, column.higher_is_better, column.per_image) == ("dB", True, False)
    assert score_column("psnr", per_image=True).per_image
