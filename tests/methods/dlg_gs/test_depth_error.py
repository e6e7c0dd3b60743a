"""The error of a disparity with its gradient by hand, and its weight, against the reference's."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.methods.dlg_gs.depth_error import appearance_weight, disparity_error
from splatproof.reference.supervision import depth_constraint as reference

D = torch.float64


def both(disparity, target, valid, weight):
    """Value and gradient, here and in the reference."""
    found = []
    for error in (disparity_error, reference.disparity_error):
        leaf = disparity.clone().requires_grad_()
        value = error(leaf, target, valid, weight)
        (3 * value).backward()
        found.append((value.detach(), torch.zeros_like(leaf) if leaf.grad is None else leaf.grad))
    return found


@settings(max_examples=40)
@given(
    size=st.tuples(st.integers(1, 24), st.integers(1, 24)), seed=st.integers(0, 2**20),
    known=st.sampled_from([0.0, 0.5, 1.0]), dtype=st.sampled_from([D, torch.float32]),
)  # fmt: skip
def test_it_is_the_references(size, seed, known, dtype):
    g = torch.Generator().manual_seed(seed)
    draw = lambda: torch.rand(size, generator=g, dtype=dtype)
    disparity, weight, valid = 5 * draw(), draw(), draw() < known
    target = reference.normalise_disparity(draw(), valid)
    (value, gradient), (want, by) = both(disparity, target, valid, weight)
    assert_close(value, want)
    assert_close(gradient, by)


@pytest.mark.parametrize("dtype", [D, torch.float32])
@pytest.mark.parametrize("seed", range(20))
def test_where_the_error_is_0_it_pulls_as_the_references(dtype, seed):
    """Of two pixels in one order both have the target's value: there rounding has the sign, and it is the same."""
    draw = lambda at: torch.rand(1, 2, generator=torch.Generator().manual_seed(at), dtype=dtype)
    disparity, every = 5 * draw(seed), torch.ones(1, 2, dtype=torch.bool)
    target = reference.normalise_disparity(draw(seed + 100).sort().values, every)
    (_, gradient), (_, by) = both(disparity.sort().values, target, every, draw(seed + 200))
    assert_close(gradient, by)


@pytest.mark.parametrize("level", [0.0, 0.7])
def test_a_constant_map_pulls_on_nothing(level):
    target = torch.rand(4, 5, generator=torch.Generator().manual_seed(0), dtype=D)
    every, ones = torch.ones(4, 5, dtype=torch.bool), torch.ones(4, 5, dtype=D)
    (value, gradient), (want, by) = both(torch.full((4, 5), level, dtype=D), target, every, ones)
    assert_close(value, want)
    assert not gradient.any()
    assert not by.any()


def test_what_is_not_known_may_be_anything():
    disparity = torch.rand(3, 4, generator=torch.Generator().manual_seed(1), dtype=D)
    valid = torch.arange(12).reshape(3, 4) % 3 > 0
    target = reference.normalise_disparity(disparity.flip(0), valid)
    wild = torch.where(valid, disparity, torch.tensor(torch.inf, dtype=D))
    (value, gradient), (want, by) = both(wild, target, valid, torch.ones(3, 4, dtype=D))
    assert_close(value, want)
    assert_close(gradient, by)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("dtype", [D, torch.float32])
def test_the_weight_is_the_references(dtype):
    """Without gradient, and of renders that lie side by side in memory."""
    both = torch.rand(5, 7, 6, generator=torch.Generator().manual_seed(2), dtype=dtype)
    both[0, 0], both[0, 1, :3] = 0.5, 3.0
    adapted, original = both.requires_grad_().split(3, dim=-1)
    weight = appearance_weight(adapted, original)
    far = 4 * torch.finfo(dtype).eps
    assert_close(weight, reference.appearance_weight(adapted, original), atol=far, rtol=0)
    assert not weight.requires_grad
    assert weight[0, 0] == 1
    assert weight[0, 1] == 0
