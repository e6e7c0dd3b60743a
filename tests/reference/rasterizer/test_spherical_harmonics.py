import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import sph_harm_y
from torch.testing import assert_close

from splatproof.reference.rasterizer import spherical_harmonics as sh

D = torch.float64


def directions(n: int, seed: int) -> torch.Tensor:
    raw = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=D)
    return raw / raw.norm(dim=1, keepdim=True)


def scipy_basis(way: torch.Tensor) -> torch.Tensor:
    """Real harmonics of scipy, orders m = -l..l; its Condon-Shortley phase gives the signs."""
    polar, azimuth = torch.acos(way[:, 2]).numpy(), torch.atan2(way[:, 1], way[:, 0]).numpy()
    columns = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, azimuth)
            part = value.imag if order < 0 else value.real
            columns.append(torch.tensor(part) * (math.sqrt(2) if order else 1))
    return torch.stack(columns, dim=1)


@given(n=st.integers(1, 8), seed=st.integers(0, 2**16))
def test_matches_scipy(n, seed):
    way = directions(n, seed)
    assert_close(sh.basis(way, 3), scipy_basis(way), atol=1e-12, rtol=0)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lower_degrees_are_prefixes(degree):
    way = directions(5, 0)
    assert_close(sh.basis(way, degree), sh.basis(way, 3)[:, : (degree + 1) ** 2])


@given(level=st.floats(0, 1))
def test_dc_round_trip(level):
    coefficients = torch.full((1, 1, 3), (level - 0.5) / sh.C0, dtype=D)
    assert_close(
        sh.colour(coefficients, directions(1, 0)), torch.full((1, 3), level, dtype=D), atol=1e-12,
        rtol=0,
    )  # fmt: skip


def test_dark_side_is_clamped_without_gradient():
    coefficients = torch.full((1, 1, 3), -10.0, dtype=D, requires_grad=True)
    seen = sh.colour(coefficients, directions(1, 0))
    assert_close(seen, torch.zeros(1, 3, dtype=D))
    seen.sum().backward()
    assert coefficients.grad is not None
    assert not coefficients.grad.any()


def test_direction_to_the_camera_centre_itself_is_zero_and_finite():
    mean = torch.ones(1, 3, dtype=D, requires_grad=True)
    way = sh.directions_to(mean, torch.ones(3, dtype=D))
    way.sum().backward()
    assert not way.any()
    assert mean.grad is not None
    assert not mean.grad.any()


def test_gradient():
    generator = torch.Generator().manual_seed(3)
    means = torch.randn(3, 3, generator=generator, dtype=D).requires_grad_()
    coefficients = (torch.randn(3, 16, 3, generator=generator, dtype=D) * 0.1).requires_grad_()
    centre = torch.tensor([0.1, 0.2, 3.0], dtype=D)
    assert torch.autograd.gradcheck(
        lambda m, c: sh.colour(c, sh.directions_to(m, centre)), (means, coefficients)
    )
