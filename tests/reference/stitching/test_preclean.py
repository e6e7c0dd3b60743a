"""Pre-cleaning: the three rules by hand, and a model is never emptied."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.reference.stitching import preclean
from splatproof.reference.stitching.preclean import AS_RELEASED, CleanSettings

OURS = CleanSettings()
ALL = replace(OURS, volume_quantile=1.0)


def test_each_rule_by_hand():
    # Opacity 0.01 is logit -4.59512: under the threshold -4.595 by a hair, so it goes.
    logits = torch.tensor([0.0, math.log(0.01 / 0.99), -4.59, 0.0, 0.0, 0.0])
    scales = torch.tensor([[1.0, 1, 1], [1, 1, 1], [1, 1, 1], [1, 60, 1], [49.9, 1, 1], [2, 2, 2]])
    assert preclean.preclean(logits, scales.log(), ALL).tolist() == [1, 0, 1, 0, 1, 1]
    # Volumes of what is left: 1, 1, 49.9, 8. Their median is 4.5 by logs between 1 and 8.
    half = replace(OURS, volume_quantile=0.5)
    assert preclean.preclean(logits, scales.log(), half).tolist() == [1, 0, 1, 0, 0, 0]


@settings(max_examples=40)
@given(count=st.integers(0, 60), seed=st.integers(0, 2**16), share=st.floats(0, 1))
def test_a_model_is_never_emptied_and_kept_volumes_are_smallest(count, seed, share):
    g = torch.Generator().manual_seed(seed)
    logits = 4 * torch.randn(count, generator=g)
    log_scales = 3 * torch.randn(count, 3, generator=g)
    kept = preclean.preclean(logits, log_scales, replace(OURS, volume_quantile=share))
    assert kept.any() or count == 0
    survivors = (logits > OURS.least_logit) & (log_scales.exp() < OURS.largest_scale).all(dim=1)
    volume = log_scales.sum(dim=1)
    lost = survivors & ~kept
    if survivors.any():
        assert not (kept & ~survivors).any()
    if lost.any():
        assert volume[kept].max() <= volume[lost].min()


@pytest.mark.parametrize("logits", [torch.full((5,), -9.0), torch.full((5,), -math.inf)])
def test_a_rule_that_would_leave_nothing_is_skipped(logits):
    assert preclean.preclean(logits, torch.zeros(5, 3), OURS).all()


def test_a_skipped_rule_still_drops_what_is_broken_or_huge():
    logits = torch.tensor([-9.0, -9, math.nan, -9])
    log_scales = torch.tensor([[0.0] * 3, [1.0] * 3, [0.0] * 3, [2.0] * 3])
    assert preclean.preclean(logits, log_scales, ALL).tolist() == [1, 1, 0, 1]
    half = replace(OURS, volume_quantile=0.5)
    assert preclean.preclean(logits, log_scales, half).tolist() == [1, 1, 0, 0]


def test_numbers_that_are_not_finite_go_first():
    logits = torch.tensor([0.0, math.nan, 0, 0, 0])
    log_scales = torch.zeros(5, 3)
    log_scales[2, 1], log_scales[3, 0] = math.nan, math.inf
    log_scales[4, 2] = -math.inf  # a scale of 0: thin, not broken
    assert preclean.preclean(logits, log_scales, ALL).tolist() == [1, 0, 0, 0, 1]


def test_tiny_volumes_do_not_underflow():
    # exp(-400 - 400 - 400) is 0 in any float; by logs the two still differ.
    log_scales = torch.tensor([[-400.0, -400, -400], [-401, -400, -400]])
    half = replace(OURS, volume_quantile=0.5)
    assert preclean.preclean(torch.zeros(2), log_scales, half).tolist() == [0, 1]


def test_the_release_ranks_by_a_product_of_logs():
    # Scales e^-1 and e^-3: volumes e^-3 > e^-9, products of logs -1 > -27, the same order here;
    # with an even number of negative logs it turns around: (-1)(-1)(1) = 1 < (-3)(-3)(1) = 9.
    log_scales = torch.tensor([[-1.0, -1, 1], [-3, -3, 1]])
    half = replace(OURS, volume_quantile=0.5)
    assert preclean.preclean(torch.zeros(2), log_scales, half).tolist() == [0, 1]
    released = replace(AS_RELEASED, volume_quantile=0.5)
    assert preclean.preclean(torch.zeros(2), log_scales, released).tolist() == [1, 0]


@pytest.mark.parametrize("rules", [OURS, AS_RELEASED])
@pytest.mark.parametrize("flat", [1, 2, 3])
def test_scales_of_zero_do_not_empty_a_model(rules, flat):
    # Of three volumes 0.999 lies between the second and the third: of -inf and a number, or of two -inf.
    log_scales = torch.tensor([[0.5, 0, 0], [-1.0, -1, -1], [-1.5, -1, -1]])
    log_scales[:flat, 0] = -math.inf
    kept = preclean.preclean(torch.zeros(3), log_scales, rules)
    assert kept.any()
    assert (
        kept[:flat].all() or rules.volume_of_logs
    )  # two logs below 0 beside it are a large product
    assert preclean.preclean(torch.zeros(3), log_scales, replace(rules, volume_quantile=1.0)).all()


@settings(max_examples=40)
@given(count=st.integers(1, 60), seed=st.integers(0, 2**16), share=st.floats(0, 1))
def test_the_quantile_keeps_what_numpys_line_between_volumes_keeps(count, seed, share):
    log_scales = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    volume = log_scales.sum(dim=1).double().numpy()
    kept = preclean.preclean(torch.zeros(count), log_scales, replace(OURS, volume_quantile=share))
    assert kept.tolist() == (volume <= np.quantile(volume, share)).tolist()
