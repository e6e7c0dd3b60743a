"""What breaking each image rule is worth, measured on photos: the traps of the protocol."""

import dataclasses

import numpy as np
import pytest
import torch
from skimage import data

from helpers.images import photo, spoiled
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import scene_metrics, score_image


def psnrs(render, truth):
    rules = {
        name: dataclasses.replace(load_protocol(name), metrics=("psnr",))
        for name in ("default", "truncate", "float")
    }
    return {name: score_image("a", render, truth, p).metrics["psnr"] for name, p in rules.items()}


@pytest.mark.parametrize(
    ("noise", "level", "cost"), [(0.03, 30.4, 0.02), (0.0075, 42.4, 0.29), (0.005, 45.8, 0.60)]
)
def test_truncation_costs_most_where_renders_are_best(noise, level, cost):
    """With d = 1/255, rounding adds d^2/12 to the MSE and truncation d^2/3: half a step of bias.

    Renders away from 0 and 1, so that no noise is clipped. The tolerance is three standard errors
    of the MSE of 720,000 numbers, in dB.
    """
    truth = 0.1 + 0.8 * photo()
    render = spoiled(truth, noise)
    got = psnrs(render, truth)
    error = 3 * 10 / np.log(10) * np.sqrt(2 / truth.numel())
    mse = {"float": 0.0, "default": 1 / 12 / 255**2, "truncate": 1 / 3 / 255**2}
    for name, added in mse.items():
        assert got[name] == pytest.approx(-10 * np.log10(noise**2 + added), abs=error)
    assert got["default"] == pytest.approx(level, abs=0.1)
    assert got["default"] - got["truncate"] == pytest.approx(cost, abs=0.02)


def test_saved_8_bit_renders_score_the_same_under_every_rounding():
    truth = photo()
    saved = torch.round(spoiled(truth, 0.02) * 255) / 255
    assert len(set(psnrs(saved, truth).values())) == 1


def test_mean_of_psnr_is_not_the_psnr_of_the_mean():
    """Views 3 dB apart or more: the mean of the values lies above that of pooled pixels."""
    truth = photo()
    rules = dataclasses.replace(load_protocol("default"), metrics=("psnr",))
    noises = (0.02, 0.04, 0.08)
    got = scene_metrics(score_image(str(s), spoiled(truth, s), truth, rules) for s in noises)
    assert 1.0 < got["psnr"] - got["psnr_of_mean_mse"] < 3.0


@pytest.mark.parametrize("share", [0.9, 0.7, 0.5, 0.2])
def test_the_masks_size_does_not_move_the_score(share):
    """Uniform noise: valid pixels score alike however few they are; multiplied ones would not."""
    truth = torch.full((300, 400, 3), 0.5)
    render = spoiled(truth, 0.05)
    mask = torch.zeros(300, 400, dtype=torch.bool)
    mask[:, : int(400 * share)] = True
    rules = load_protocol("default")
    whole = score_image("a", render, truth, rules)
    part = score_image("a", render, truth, rules, mask)
    multiplied = score_image("a", render * mask[..., None], truth * mask[..., None], rules)
    assert part.valid_share == pytest.approx(share, abs=1e-6)
    assert part.metrics["psnr"] == pytest.approx(whole.metrics["psnr"], abs=0.1)
    assert part.metrics["ssim_valid"] == pytest.approx(whole.metrics["ssim_valid"], abs=0.01)
    inflated = multiplied.metrics["psnr"] - part.metrics["psnr"]
    assert inflated == pytest.approx(-10 * np.log10(share), abs=0.05)
    if share <= 0.5:
        assert multiplied.metrics["ssim_valid"] > part.metrics["ssim_valid"] + 0.3


def test_borders_move_ssim_and_weigh_less_on_larger_images():
    gaps = []
    for size in (64, 256):
        truth = torch.from_numpy(data.astronaut()[:size, :size].astype(np.float32) / 255)
        score = score_image("a", spoiled(truth, 0.05), truth, load_protocol("default"))
        gaps.append(abs(score.metrics["ssim_3dgs"] - score.metrics["ssim_valid"]))
    assert 0.001 < gaps[1] < gaps[0]


def test_a_colour_fit_sees_the_truth_and_is_worth_decibels():
    truth = photo()
    render = spoiled((0.85 * truth + 0.05) ** 1.1, 0.02)
    rules = dataclasses.replace(
        load_protocol("default"), metrics=("psnr",), colour_fit=("cc_affine", "cc_quadratic")
    )
    got = score_image("a", render, truth, rules).metrics
    assert got["cc_quadratic_psnr"] >= got["cc_affine_psnr"] > got["psnr"] + 3
