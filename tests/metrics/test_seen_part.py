"""Scores of what training photos can have shown."""

import math

import pytest
import torch

from splatproof.metrics.pixel import psnr
from splatproof.metrics.scoring import scene_metrics, score_image
from splatproof.metrics.seen_part import with_seen
from splatproof.reference.types.protocol import Protocol
from splatproof.reports.columns import score_column

RULES = Protocol(name="flight", source="test", rounding="float", metrics=("psnr", "flip"))
H, W = 20, 30


def pictures():
    draw = torch.Generator().manual_seed(0)
    truth = torch.rand(H, W, 3, generator=draw)
    return (truth + 0.1 * torch.randn(H, W, 3, generator=draw)).clamp(0, 1), truth


def scored(seen, *, render=None, mask=None, rules=RULES, apart=True):
    image, truth = pictures()
    image = image if render is None else render
    plain = score_image("a", image, truth, rules, mask)
    return plain, with_seen(plain, image, truth, rules, mask, seen, apart=apart)


def test_a_band_that_no_photo_shows_does_not_lower_the_score_of_the_rest():
    seen = torch.ones(H, W, dtype=torch.bool)
    seen[:, :6] = False
    image, truth = pictures()
    black = image.clone()
    black[:, :6] = 0.0
    plain, own = scored(seen, render=black)
    assert own.metrics["seen_share"] == pytest.approx(0.8)
    assert own.metrics["seen_psnr"] == pytest.approx(psnr(image[:, 6:], truth[:, 6:]))
    assert own.metrics["seen_psnr"] > plain.metrics["psnr"] + 3
    assert {name: own.metrics[name] for name in plain.metrics} == plain.metrics


def test_seen_whole_is_the_image_itself():
    plain, own = scored(torch.ones(H, W, dtype=torch.bool))
    assert own.metrics["seen_psnr"] == plain.metrics["psnr"]
    assert own.metrics["seen_flip"] == plain.metrics["flip"]


def test_mask_and_region_are_kept():
    seen = torch.zeros(H, W, dtype=torch.bool)
    seen[:, 20:] = True
    mask = torch.zeros(H, W, dtype=torch.bool)
    mask[:, 10:25] = True
    assert scored(seen, mask=mask)[1].metrics["seen_share"] == pytest.approx(5 / 15)
    half = Protocol(name="half", source="test", metrics=("psnr",), region="right_half")
    assert scored(seen, rules=half)[1].metrics["seen_share"] == pytest.approx(10 / 15)


def test_nothing_seen_and_nothing_known_have_no_score():
    nothing = scored(torch.zeros(H, W, dtype=torch.bool))[1].metrics
    assert nothing["seen_share"] == 0
    assert math.isnan(nothing["seen_psnr"])
    unknown = scored(None)[1].metrics
    assert math.isnan(unknown["seen_share"])
    assert math.isnan(unknown["seen_psnr"])


def test_only_the_share_is_told_where_the_part_is_not_scored_apart():
    plain, own = scored(torch.ones(H, W, dtype=torch.bool), apart=False)
    assert own.metrics.keys() == {*plain.metrics, "seen_share"}


def test_the_mean_is_over_images_that_have_the_part():
    seen = torch.ones(H, W, dtype=torch.bool)
    images = [scored(seen)[1], scored(~seen)[1]]
    means = scene_metrics(images)
    assert means["seen_share"] == pytest.approx(0.5)
    assert means["seen_psnr"] == images[0].metrics["seen_psnr"]


def test_tables_know_the_columns():
    column = score_column("seen_psnr", per_image=True)
    assert column.per_image
    assert column.higher_is_better
    assert column.unit == "dB"
    share = score_column("seen_share", per_image=True)
    assert share.per_image
    assert share.higher_is_better is None
