"""The equations of many matches at once give the vectors of the SVD."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.methods.training.least_vectors import least_vectors
from splatproof.reference.supervision import dense_initialisation as reference


def systems(count: int, seed: int, miss: float, stretch: float) -> torch.Tensor:
    """Equations that some vector fulfils but for noise, in a frame whose last axis is `stretch` times as long."""
    generator = torch.Generator().manual_seed(seed)
    rows = torch.randn(count, 4, 4, generator=generator, dtype=torch.float64)
    rows[:, 3] = rows[:, :3].sum(dim=1)
    rows = rows + miss * torch.randn(count, 4, 4, generator=generator, dtype=torch.float64)
    return rows * torch.tensor([1.0, 1.0, 1.0, stretch], dtype=torch.float64)


@given(
    count=st.integers(0, 20), seed=st.integers(0, 2**16), miss=st.sampled_from([0.0, 1e-6, 1e-3]),
    stretch=st.sampled_from([1e-2, 1.0, 1e2]), size=st.sampled_from([1e-30, 1.0, 1e30]),
)  # fmt: skip
def test_it_is_the_vector_of_the_svd(count, seed, miss, stretch, size):
    found = systems(count, seed, miss, stretch)
    _, values, axes = torch.linalg.svd(found)
    apart = (values[:, 3] < 0.05 * values[:, 2]) & (values[:, 2] > 1e-3 * values[:, 0])
    got, want = least_vectors(size * found)[apart], axes[apart, 3]
    assert_close(got.norm(dim=1), torch.ones(len(got), dtype=got.dtype))
    # cofactors lose the squares of the singular values' ratios, (1e3)^2 here, from 1e-16
    assert_close(
        (got * want).sum(dim=1).abs(), torch.ones(len(got), dtype=got.dtype), atol=1e-9, rtol=0
    )
    assert_close(got * (got * want).sum(dim=1, keepdim=True).sign(), want, atol=3e-6, rtol=0)


def test_no_equations_give_no_numbers_that_are_not_finite():
    assert least_vectors(torch.zeros(3, 4, 4, dtype=torch.float64)).isfinite().all()


def test_points_of_a_pair_are_the_references():
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = -0.7
    intrinsics = torch.tensor([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]], dtype=torch.float64)
    a = reference.Camera(
        K=intrinsics, world_to_camera=torch.eye(4, dtype=torch.float64), width=64, height=48
    )
    b = reference.Camera(K=intrinsics, world_to_camera=pose, width=64, height=48)
    generator = torch.Generator().manual_seed(0)
    warp = (
        torch.tensor([-9.0, 0.0]).double()
        + 0.5 * torch.randn(48, 64, 2, generator=generator).double()
    )
    image = torch.rand(48, 64, 3, generator=generator)
    rest = (a, b, image, warp, torch.full((48, 64), 0.9), reference.DenseSettings())
    want, got = reference.points_of_pair(*rest), reference.points_of_pair(*rest, least_vectors)
    assert len(want.positions) > 1000
    assert_close(got.positions, want.positions, atol=1e-9, rtol=1e-9)
    assert_close(got.scores, want.scores, atol=1e-9, rtol=0)
    assert torch.equal(got.colours, want.colours)
