import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.supervision import soft_rank as sr

D = torch.float64


def distinct(n: int, seed: int) -> Tensor:
    """Values at least 0.1 apart, in random order."""
    g = torch.Generator().manual_seed(seed)
    steps = 0.1 + torch.rand(n, generator=g, dtype=D)
    return steps.cumsum(0)[torch.randperm(n, generator=g)]


@given(n=st.integers(0, 30), seed=st.integers(0, 2**16), tau=st.floats(0.01, 10))
def test_matches_the_double_loop(n, seed, tau):
    z = distinct(n, seed)
    want = [sum(torch.sigmoid((b - a) / tau).item() for b in z) for a in z]
    assert sr.soft_rank(z, tau).tolist() == pytest.approx(want)


@given(n=st.integers(1, 30), seed=st.integers(0, 2**16))
def test_cold_ranks_are_the_discrete_ones(n, seed):
    z = distinct(n, seed)
    want = torch.tensor(stats.rankdata(-z.numpy())) - 0.5
    assert_close(sr.soft_rank(z, 1e-3), want)


@given(n=st.integers(2, 30), seed=st.integers(0, 2**16))
def test_cold_correlation_is_scipys_and_ignores_monotone_maps(n, seed):
    a, b = distinct(n, seed), distinct(n, seed + 1)
    want = float(stats.spearmanr(a.numpy(), b.numpy())[0])
    # Steps of 0.1 stay above 1e-3 deviations under these maps, a hundred times the temperature.
    assert float(sr.spearman(a, b, 1e-5)) == pytest.approx(want, abs=1e-9)
    bent = (a / 10).exp(), (b / 10) ** 3 + b + 5
    assert float(sr.spearman(*bent, 1e-5)) == pytest.approx(want, abs=1e-9)


@given(n=st.integers(2, 30), seed=st.integers(0, 2**16), tau=st.floats(1e-3, 10))
def test_correlation_bounds(n, seed, tau):
    a, b = distinct(n, seed), distinct(n, seed + 1)
    assert -1 - 1e-12 <= float(sr.spearman(a, b, tau)) <= 1 + 1e-12
    assert float(sr.spearman(a, a, tau)) == pytest.approx(1)
    assert float(sr.spearman(a, -a, tau)) == pytest.approx(-1)
    assert float(sr.global_depth_loss(a, a, tau)) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("n", [0, 1, 7])
def test_constant_depth_has_no_order_and_no_gradient(n):
    constant = torch.full((n,), 3.0, dtype=D, requires_grad=True)
    rho = sr.spearman(constant, distinct(n, 0), 0.1)
    assert float(rho.detach()) == 0
    rho.backward()
    assert constant.grad is not None
    assert_close(constant.grad, torch.zeros_like(constant))


@pytest.mark.parametrize("value", [0.1, 1.7, 3.0, 1e-30, 1e30])
@pytest.mark.parametrize("n", [7, 100, 1000])
def test_a_constant_in_single_precision_has_no_gradient(n, value):
    """The mean of equal numbers is rounded: what is left of them must not count as a spread."""
    constant = torch.full((n,), value, requires_grad=True)
    rho = sr.correlation(constant, torch.rand(n, generator=torch.Generator().manual_seed(0)))
    assert float(rho.detach()) == 0
    rho.backward()
    assert constant.grad is not None
    assert not constant.grad.any()


@pytest.mark.parametrize("unit", [1e-25, 1e25])
def test_correlation_of_single_precision_is_numpys_in_any_unit(unit):
    a, b = (torch.randn(50, generator=torch.Generator().manual_seed(k)) for k in (0, 1))
    want = np.corrcoef(a.numpy(), b.numpy())[0, 1]
    assert float(sr.correlation(a * unit, b + 3)) == pytest.approx(want, abs=1e-5)


@given(seed=st.integers(0, 2**16), unit=st.floats(1e-3, 1e3), shift=st.floats(-100, 100))
def test_one_temperature_serves_two_units(seed, unit, shift):
    """Metres against the numbers of a network: units and zero points of either change nothing."""
    a, b = distinct(20, seed), distinct(20, seed + 1)
    want = sr.spearman(a, b, 0.3)
    assert_close(sr.spearman(unit * a + shift, b, 0.3), want, atol=1e-8, rtol=0)
    assert_close(sr.spearman(a, unit * b + shift, 0.3), want, atol=1e-8, rtol=0)


def test_temperature_is_in_standard_deviations():
    a, b = distinct(12, 0), distinct(12, 1)
    ranks = [sr.soft_rank(z / z.std(correction=0), 0.4).numpy() for z in (a, b)]
    assert float(sr.spearman(a, b, 0.4)) == pytest.approx(np.corrcoef(ranks)[0, 1])


@pytest.mark.parametrize("tau", [1e-8, 1e8])
def test_extreme_temperatures_stay_finite(tau):
    a = distinct(9, 0).requires_grad_()
    loss = sr.global_depth_loss(a, distinct(9, 1), tau)
    loss.backward()
    assert torch.isfinite(loss)
    assert a.grad is not None
    assert a.grad.isfinite().all()


def test_ties_share_their_rank():
    z = torch.tensor([2.0, 1.0, 2.0, 3.0], dtype=D)
    # Above 2 lies one value; itself and its twin count one half each.
    assert_close(sr.soft_rank(z, 1e-3), torch.tensor([2.0, 3.5, 2.0, 0.5], dtype=D))


def test_rows_are_only_split_for_memory(monkeypatch):
    z = distinct(25, 3)
    whole = sr.soft_rank(z, 0.3)
    monkeypatch.setattr("splatproof.reference.supervision.soft_rank.ROWS_AT_ONCE", 4)
    assert_close(sr.soft_rank(z, 0.3), whole)


def test_a_million_pixels_are_ranked_on_a_sample():
    # The direct form is quadratic: the loss is meant for a sample, and says nothing about n.
    g = torch.Generator().manual_seed(0)
    depth = torch.rand(1_000_000, generator=g)
    sample = torch.randint(0, len(depth), (512,), generator=g)
    assert float(sr.spearman(depth[sample], depth[sample] * 2, 0.01)) == pytest.approx(1, abs=1e-3)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**16))
def test_gradient(seed):
    a, b = distinct(6, seed).requires_grad_(), distinct(6, seed + 1).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, y: sr.global_depth_loss(x, y, 0.3), (a, b))


@pytest.mark.parametrize(("values", "tau"), [([1.0, 2.0], 0.0), ([1.0, float("nan")], 1.0)])
def test_senseless_input_is_refused(values, tau):
    with pytest.raises(ValueError, match=r"temperature|finite"):
        sr.soft_rank(torch.tensor(values), tau)
    with pytest.raises(ValueError, match=r"temperature|finite"):
        sr.spearman(torch.tensor(values), torch.tensor([1.0, 3.0]), tau)
