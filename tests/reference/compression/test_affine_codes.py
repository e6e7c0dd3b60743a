"""8-bit codes: the bound r/510, straight-through gradients, and input that must be refused."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError
from splatproof.reference.compression import affine_codes as ac

SEEDS = st.integers(0, 2**16)
EPS = torch.finfo(torch.float32).eps


def values(count: int, width: int, seed: int) -> Tensor:
    """Columns of very different sizes and offsets."""
    g = torch.Generator().manual_seed(seed)
    size = 10 ** (6 * torch.rand(width, generator=g) - 4)
    return torch.randn(count, width, generator=g) * size + torch.randn(width, generator=g)


def bound(rows: Tensor, codes: ac.AffineCodes) -> Tensor:
    """Half a step, plus the float32 rounding of m, of r and of the result."""
    return codes.range / 510 + 4 * EPS * (rows.abs().amax(dim=0) + codes.range)


@settings(max_examples=60)
@given(count=st.integers(0, 40), width=st.integers(0, 9), seed=SEEDS)
def test_values_come_back_within_half_a_step(count, width, seed):
    rows = values(count, width, seed)
    codes = ac.encode(rows)
    back = ac.decode(codes)
    assert back.shape == rows.shape
    if count:
        assert ((back - rows).abs() <= bound(rows, codes)).all()
        used = codes.range > 0
        assert (codes.codes[:, used].amin(dim=0) == 0).all()
        assert (codes.codes[:, used].amax(dim=0) == 255).all()


def test_the_bound_rejects_truncation():
    rows = values(200, 5, 0)
    codes = ac.encode(rows, "truncate")
    assert ((ac.decode(codes) - rows).abs() > bound(rows, codes)).any()
    # Half a step too low on average; the rounded ones are not.
    step = codes.range / 255
    assert float(((rows - ac.decode(codes)) / step).mean()) == pytest.approx(0.5, abs=0.05)
    assert float(((rows - ac.decode(ac.encode(rows))) / step).mean()) == pytest.approx(0, abs=0.05)


@settings(max_examples=30)
@given(count=st.integers(1, 30), width=st.integers(1, 5), seed=SEEDS)
def test_codes_are_the_papers_formula(count, width, seed):
    rows = values(count, width, seed).numpy().astype(np.float64)
    m = rows.min(axis=0)
    r = rows.max(axis=0) - m
    want = np.clip(np.round(255 * (rows - m) / np.where(r > 0, r, 1)), 0, 255)
    found = ac.encode(torch.from_numpy(rows)).codes.numpy()
    # m and r are stored in float32: a value within their rounding of a step's middle may go either way.
    assert np.abs(found - want).max() <= 1
    assert (found != want).mean() <= 0.01 + 1 / found.size


def test_codes_by_hand():
    # m = -1, r = 2: a step is 2/255; 0 lies at 127.5, which rounds to the even 128.
    rows = torch.tensor([[-1.0, 7], [1, 7], [0, 7], [-0.5, 7]])
    codes = ac.encode(rows)
    assert codes.codes[:, 0].tolist() == [0, 255, 128, 64]
    assert codes.low.tolist() == [-1, 7]
    assert codes.range.tolist() == [2, 0]
    assert_close(ac.decode(codes)[2, 0], torch.tensor(-1 + 2 / 255 * 128))
    assert ac.encode(rows, "truncate").codes[:, 0].tolist() == [0, 255, 127, 63]


def test_a_constant_dimension_stores_its_value():
    back = ac.decode(ac.encode(torch.full((5, 3), 0.1)))
    assert (back == 0.1).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused(bad):
    with pytest.raises(DataError, match="1 of 6 values"):
        ac.encode(torch.tensor([[0.0, 1, 2], [3, bad, 5]]))


def test_a_range_beyond_float32_is_refused():
    with pytest.raises(DataError, match="float32"):
        ac.encode(torch.tensor([[-3e38], [3e38]]))


def test_one_outlier_costs_its_dimension_the_resolution():
    rows = values(1000, 2, 3).clamp(-1, 1)
    spoilt = rows.clone()
    spoilt[0, 0] = 1e6
    clean, dear = ac.encode(rows), ac.encode(spoilt)
    assert float(dear.range[0] / 255) == pytest.approx(1e6 / 255, rel=1e-3)
    error = (ac.decode(dear) - spoilt).abs()[1:]
    assert float(error[:, 0].max()) > 100 * float((ac.decode(clean) - rows).abs()[:, 0].max())
    assert torch.equal(dear.codes[:, 1], clean.codes[:, 1])  # the others pay nothing


@settings(max_examples=40)
@given(count=st.integers(0, 20), width=st.integers(0, 6), seed=SEEDS)
def test_fake_quantisation_is_what_will_come_back(count, width, seed):
    rows = values(count, width, seed)
    low, reach = ac.lattice(rows)
    back = ac.decode(ac.encode(rows))
    exact = ac.fake_quantise(rows.double(), low.double(), reach.double())
    assert_close(exact.float(), back, rtol=0, atol=0)
    # Trained in float32, a value near the middle of a step may fall to the other side of it.
    off = (ac.fake_quantise(rows, low, reach) - back).abs()
    assert (off <= reach / 255 + 4 * EPS * (rows.abs() + reach)).all()


@settings(max_examples=40)
@given(count=st.integers(1, 20), seed=SEEDS)
def test_the_gradient_goes_straight_through_inside_the_range_only(count, seed):
    rows = values(count, 3, seed).double().requires_grad_()
    low, reach = (t.double() for t in ac.lattice(rows.detach()))
    cotangent = torch.randn(
        count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    shrunk_low, shrunk = low + 0.25 * reach, 0.5 * reach
    (ac.fake_quantise(rows, shrunk_low, shrunk) * cotangent).sum().backward()
    within = (rows >= shrunk_low) & (rows <= shrunk_low + shrunk)
    assert rows.grad is not None
    assert torch.equal(rows.grad, torch.where(within, cotangent, 0))
    outside = ac.fake_quantise(rows.detach(), shrunk_low, shrunk)
    assert (outside >= shrunk_low - 1e-12 * reach).all()
    assert (outside <= shrunk_low + shrunk * (1 + 1e-12)).all()


def test_values_on_the_lattice_stay():
    lattice_points = torch.arange(256).double()[:, None] / 255 * 3 - 1
    low, reach = ac.lattice(lattice_points)
    assert_close(ac.fake_quantise(lattice_points, low.double(), reach.double()), lattice_points)
    assert torch.equal(ac.encode(lattice_points).codes[:, 0].long(), torch.arange(256))
