import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from splatproof.reference.rasterizer import rotation

D = torch.float64


def quaternions(n: int, seed: int) -> torch.Tensor:
    return torch.randn(n, 4, generator=torch.Generator().manual_seed(seed), dtype=D)


@given(n=st.integers(0, 8), seed=st.integers(0, 2**16))
def test_matches_scipy(n, seed):
    q = quaternions(n, seed)
    want = torch.stack(
        [torch.tensor(Rotation.from_quat(row.roll(-1).numpy()).as_matrix()) for row in q]
    ) if n else torch.empty(0, 3, 3, dtype=D)  # fmt: skip
    assert_close(rotation.rotation_matrix(q), want, atol=1e-14, rtol=0)


@given(seed=st.integers(0, 2**16), power=st.integers(-60, 60))
def test_norm_does_not_matter(seed, power):
    q = quaternions(3, seed)
    assert_close(
        rotation.rotation_matrix(q * 10.0**power), rotation.rotation_matrix(q), atol=1e-14, rtol=0
    )


@pytest.mark.parametrize("norm", [1e-30, 1e-6, 1e6, 1e30])
def test_float32_keeps_extreme_norms(norm):
    q = quaternions(5, 1).float()
    want = rotation.rotation_matrix(q.double())
    got = rotation.rotation_matrix(q * norm)
    assert_close(got.double(), want, atol=1e-6, rtol=0)  # a few products of float32


def test_zero_is_identity_with_zero_gradient():
    q = torch.zeros(1, 4, dtype=D, requires_grad=True)
    turned = rotation.rotation_matrix(q)
    assert_close(turned[0], torch.eye(3, dtype=D))
    turned.sum().backward()
    assert q.grad is not None
    assert_close(q.grad, torch.zeros(1, 4, dtype=D))


def test_gradient():
    q = quaternions(4, 2).requires_grad_()
    assert torch.autograd.gradcheck(rotation.rotation_matrix, q)


@given(seed=st.integers(0, 2**16))
def test_covariance_has_the_scales_as_its_spread(seed):
    generator = torch.Generator().manual_seed(seed)
    scales = torch.rand(4, 3, generator=generator, dtype=D) + 0.1
    sigma = rotation.covariance(quaternions(4, seed), scales)
    assert_close(sigma, sigma.mT)
    want = scales.square().sort(dim=1).values
    assert_close(torch.linalg.eigvalsh(sigma), want, atol=1e-12, rtol=1e-10)


def test_covariance_by_hand():
    # A quarter turn about z: (w, z) = (cos 45, sin 45); local x becomes world y.
    half = 0.5**0.5
    q = torch.tensor([[half, 0.0, 0.0, half]], dtype=D)
    sigma = rotation.covariance(q, torch.tensor([[3.0, 2.0, 1.0]], dtype=D))
    assert_close(sigma[0], torch.diag(torch.tensor([4.0, 9.0, 1.0], dtype=D)), atol=1e-14, rtol=0)
