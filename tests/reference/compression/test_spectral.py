"""Spectral energy by hand, and what a gate may and may not do."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.compression import spectral

DEGREES = st.integers(0, 3)
SEEDS = st.integers(0, 2**16)
D = torch.float64


def residual(count: int, degree: int, seed: int, scale: float = 0.04) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return scale * torch.randn(count, (degree + 1) ** 2 - 1, 3, generator=g, dtype=D)


def test_energies_by_hand():
    # All 9 numbers of order 1 are 1, one of the 15 of order 2 is -30, all 21 of order 3 are 0.
    rest = torch.zeros(1, 15, 3, dtype=D)
    rest[:, :3] = 1
    rest[0, 5, 1] = -30
    assert_close(spectral.order_energies(rest), torch.tensor([[1.0, 2, 0]], dtype=D))
    assert float(spectral.energy(rest)) == pytest.approx((9 + 30) / 45)
    assert float(spectral.energy(rest, "orders")) == pytest.approx((1 + 2 + 0) / 3)


@settings(max_examples=40)
@given(count=st.integers(0, 12), degree=DEGREES, seed=SEEDS)
def test_the_default_is_the_mean_of_all_residual_numbers(count, degree, seed):
    rest = residual(count, degree, seed)
    want = [float(row.abs().mean()) if row.numel() else 0.0 for row in rest]
    assert_close(spectral.energy(rest), torch.tensor(want, dtype=D).reshape(count))


@settings(max_examples=40)
@given(
    count=st.integers(0, 12), degree=DEGREES, seed=SEEDS, a=st.floats(0, 0.1), b=st.floats(0, 0.1)
)
def test_the_gate_is_monotone_and_all_or_nothing(count, degree, seed, a, b):
    rest = residual(count, degree, seed)
    low, high = sorted((a, b))
    open_low, open_high = spectral.open_gate(rest, low), spectral.open_gate(rest, high)
    assert not (open_high & ~open_low).any()
    kept = spectral.gated(rest, high)
    assert torch.equal(kept[open_high], rest[open_high])
    assert not kept[~open_high].any()
    assert torch.equal(spectral.gated(rest, 0.0), rest)
    assert torch.equal(spectral.gated(kept, high), kept)


def test_a_primitive_at_the_gate_stays():
    rest = torch.full((2, 15, 3), 0.5)
    rest[1] -= 2**-20
    assert spectral.open_gate(rest, 0.5).tolist() == [True, False]


def test_a_residual_of_zeros_survives_any_gate():
    assert not spectral.gated(torch.zeros(4, 15, 3), 0.02).any()


@pytest.mark.parametrize("weighting", ["coefficients", "orders"])
def test_the_energy_has_right_gradients(weighting):
    rest = residual(3, 3, 0).requires_grad_()
    assert torch.autograd.gradcheck(lambda r: spectral.energy(r, weighting), (rest,))
