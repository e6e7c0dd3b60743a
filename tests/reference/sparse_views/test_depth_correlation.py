"""FSGS's depth loss: what it does not see, its ends, its gradient, and inputs without any."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof.reference.sparse_views.depth_correlation import POLE, correlation_loss

ALL = torch.ones(6, 7, dtype=torch.bool)


def maps(seed: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    depth, prior = torch.rand(2, 6, 7, generator=generator).double()
    return 1 + 3 * depth, prior


@given(
    seed=st.integers(0, 2**16), scale=st.floats(0.01, 1000), zero=st.floats(-100, 100),
    depth_scale=st.floats(0.01, 100), depth_zero=st.floats(-50, 50),
)  # fmt: skip
def test_scale_and_zero_of_either_do_not_count(seed, scale, zero, depth_scale, depth_zero):
    depth, prior = maps(seed)
    want = correlation_loss(depth, prior, ALL)
    have = correlation_loss(depth_scale * depth + depth_zero, scale * prior + zero, ALL)
    # the map back to [0, 1] rounds: 1e-16 of a zero 10^4 times the scale
    torch.testing.assert_close(have, want, atol=1e-9, rtol=0)
    assert 0 <= float(want) <= 2


def test_both_readings_of_a_prior_have_loss_0_and_the_wrong_way_round_2():
    _, prior = maps(0)
    low, high = prior.min(), prior.max()
    unit = (prior - low) / (high - low)
    for depth in (5 - unit, 1 / (unit + POLE)):
        assert float(correlation_loss(depth, prior, ALL)) == pytest.approx(0, abs=1e-12)
    assert float(correlation_loss(unit, prior, ALL)) == pytest.approx(
        1 + float(torch.corrcoef(torch.stack([unit, -1 / (unit + POLE)]).flatten(1))[0, 1]),
        abs=1e-9,
    )


@settings(max_examples=8)  # each tries all 42 pixels
@given(seed=st.integers(0, 2**16))
def test_its_gradient_is_that_of_differences(seed):
    depth, prior = maps(seed)
    assert torch.autograd.gradcheck(
        lambda d: correlation_loss(d, prior, ALL), depth.requires_grad_(), atol=1e-6
    )


def test_constants_and_nothing_valid_give_1_and_no_gradient():
    depth, prior = maps(1)
    for bad, mask in ((prior * 0 + 3, ALL), (prior, ~ALL)):
        asked = depth.clone().requires_grad_()
        loss = correlation_loss(asked, bad, mask)
        assert float(loss.detach()) == 1
        if loss.requires_grad:
            loss.backward()
            assert asked.grad is not None
            assert not asked.grad.any()
    flat = torch.full((6, 7), 2.0, requires_grad=True)
    loss = correlation_loss(flat, prior.float(), ALL)
    loss.backward()
    assert float(loss.detach()) == 1
    assert flat.grad is not None
    assert not flat.grad.any()


def test_what_is_not_valid_is_not_read():
    depth, prior = maps(2)
    mask = ALL.clone()
    mask[0] = False
    want = correlation_loss(depth, prior, mask)
    prior[0] = torch.nan
    assert torch.equal(correlation_loss(depth, prior, mask), want)
