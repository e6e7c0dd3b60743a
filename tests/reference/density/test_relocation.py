"""Relocation: a stack shows what one did; hard cases; noise that opaque Gaussians do not feel."""

import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from torch import Tensor

from splatproof.reference.density.relocation import MOST_COPIES, nudges, stacked
from splatproof.reference.rasterizer.rotation import covariance

OPACITIES = st.floats(1e-4, 1 - 1e-6)


def stack(opacity: float, copies: int, **options: float) -> tuple[float, float]:
    """Opacity of each of a stack, and its scale over that of the one before."""
    found = stacked(
        torch.tensor([opacity], dtype=torch.float64), torch.ones(1, 3).double(), torch.tensor([copies]),
        **options,
    )  # fmt: skip
    assert found[1].unique().numel() == 1
    return float(found[0]), float(found[1][0, 0])


def across(opacity: float, scale: float, copies: int) -> float:
    """Integral of a stack's opacity along a line through its centre, by quadrature."""

    def seen(x: float) -> float:
        return 1 - (1 - opacity * math.exp(-0.5 * (x / scale) ** 2)) ** copies

    return 2 * quad(seen, 0, 12 * scale, epsabs=1e-13, epsrel=1e-11, limit=200)[0]


@given(opacity=OPACITIES, copies=st.integers(1, MOST_COPIES))
def test_a_stack_is_as_opaque_and_shows_as_much_as_the_one_before(opacity, copies):
    each, scale = stack(opacity, copies)
    assert 1 - (1 - each) ** copies == pytest.approx(opacity, rel=1e-9)
    assert across(each, scale, copies) == pytest.approx(across(opacity, 1.0, 1), rel=1e-8)


@given(opacity=st.floats(0, 1))
def test_one_copy_is_the_same(opacity):
    each, scale = stack(opacity, 1)
    assert each == pytest.approx(opacity, abs=2e-7)
    assert scale == pytest.approx(1)


@settings(max_examples=10)  # each makes all numbers of copies
@given(opacity=OPACITIES)
def test_more_copies_are_smaller_and_fainter_each(opacity):
    made = [stack(opacity, copies) for copies in range(1, MOST_COPIES + 1)]
    for (each, scale), (fainter, smaller) in pairwise(made):
        assert fainter < each
        assert smaller <= scale * (1 + 1e-12)


def test_opacities_of_0_and_1_and_more_copies_than_are_told_apart():
    for copies in (1, 2, MOST_COPIES, 10 * MOST_COPIES):
        for opacity in (0.0, 1.0):
            each, scale = stack(opacity, copies)
            assert 0 <= each < 1
            assert 0 < scale <= 1
    assert stack(0.7, MOST_COPIES) == stack(0.7, 10 * MOST_COPIES)


def test_what_is_raised_to_the_least_opacity_still_shows_as_much():
    each, scale = stack(0.01, MOST_COPIES, least=0.005)
    assert each == 0.005
    assert across(each, scale, MOST_COPIES) == pytest.approx(across(0.01, 1.0, 1), rel=1e-8)


def test_float32_gives_float32_of_the_same():
    opacities = torch.linspace(0.01, 0.999999, 60)
    copies = torch.arange(1, 61)
    scales = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    one = stacked(opacities, scales, copies)
    other = stacked(opacities.double(), scales.double(), copies)
    for have, want in zip(one, other, strict=True):
        assert have.dtype == torch.float32
        torch.testing.assert_close(have.double(), want, rtol=1e-6, atol=1e-7)


def test_none_at_all():
    empty = stacked(torch.zeros(0), torch.zeros(0, 3), torch.zeros(0, dtype=torch.int64))
    assert [tuple(part.shape) for part in empty] == [(0,), (0, 3)]


def shapes(count: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    quaternions = torch.randn(1, 4, generator=generator).double().repeat(count, 1)
    return quaternions, torch.tensor([[0.3, 1.0, 2.0]]).double().repeat(count, 1)


def test_noise_has_the_covariance_squared_and_a_gate():
    count = 40_000
    sigma = covariance(*shapes(count))
    draws = torch.randn(count, 3, generator=torch.Generator().manual_seed(2)).double()
    moved = nudges(sigma, torch.full((count,), 0.005).double(), draws)
    want = 0.25 * sigma[0] @ sigma[0]  # the gate is half open
    # 40,000 draws: a variance of 4 by 4 sqrt(2) / 200 = 0.03
    assert (moved.T.cov() - want).abs().max() < 0.12


def test_opaque_ones_hardly_move_and_transparent_ones_freely():
    sigma, draws = torch.eye(3).repeat(3, 1, 1), torch.ones(3, 3)
    moved = nudges(sigma, torch.tensor([0.0, 0.05, 1.0]), draws)[:, 0]
    assert moved[0] == pytest.approx(1 / (1 + math.exp(-0.5)), rel=1e-5)
    assert moved[1] == pytest.approx(0.011, abs=2e-4)
    assert moved[2] < 1e-30
