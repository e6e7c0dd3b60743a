"""The native diffusion against its reference in float64: values, gradient, and what makes it its own gradient."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels import diffusion
from splatproof.methods.stratosplat.denoiser import PhotoDiffusion
from splatproof.reference.layered_memory import depth_adaptation, edge_diffusion
from splatproof.reference.layered_memory.edge_diffusion import EdgeDiffusion, exchange_weights

BOUND = 1e-5
"""Largest error as a share of the largest value. Over 390 cases at all SIMD levels the largest was 2.7e-6."""
WRONG = 1e-3
"""What a lost exchange does at least."""


def drawn(height: int, width: int, contrast: float, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    image = torch.rand(height, width, 3, generator=g)
    return torch.randn(height, width, generator=g), *exchange_weights(image, contrast)


def error(values: Tensor, across: Tensor, down: Tensor, sweeps: int) -> float:
    """Of values and gradient, the larger."""
    exact, mine = values.double().requires_grad_(), values.clone().requires_grad_()
    want = edge_diffusion.diffused(exact, across.double(), down.double(), sweeps)
    got = diffusion.diffused(mine, across, down, sweeps)
    weight = torch.randn(want.shape, generator=torch.Generator().manual_seed(1))
    (right,) = torch.autograd.grad((want * weight).sum(), exact)
    (found,) = torch.autograd.grad((got * weight).sum(), mine)
    pairs = ((want.detach(), got.detach()), (right, found))
    return max(float((b.double() - a).abs().max() / a.abs().max()) for a, b in pairs)


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    height=st.integers(1, 40), width=st.integers(1, 70), sweeps=st.integers(0, 80),
    contrast=st.sampled_from([1e-3, 0.1, 1.0, 100.0]), seed=st.integers(0, 2**16),
)  # fmt: skip
def test_agrees_with_the_reference(simd_level, height, width, sweeps, contrast, seed):
    assert error(*drawn(height, width, contrast, seed), sweeps) < BOUND


@pytest.mark.parametrize("width", [15, 16, 17, 33])
def test_the_bound_sees_a_lost_exchange(width):
    values, across, down = drawn(9, width, 1.0, 0)
    for weights in (across, down):
        whole = diffusion.diffused(values, across, down, 3)
        kept = weights[-1, -1].clone()
        weights[-1, -1] = 0.0
        assert float((diffusion.diffused(values, across, down, 3) - whole).abs().max()) > WRONG
        weights[-1, -1] = kept


def test_values_do_not_pass_from_the_end_of_a_row_to_the_next():
    values = torch.zeros(3, 16)
    values[0, -1] = 1.0
    _, across, down = drawn(3, 16, 100.0, 0)
    found = diffusion.diffused(values, across, torch.zeros_like(down), 60)
    assert float(found[0].sum()) == pytest.approx(1.0, abs=1e-6)
    assert torch.equal(found[1:], values[1:])


@pytest.mark.parametrize(
    ("index", "wrong"),
    [(0, (4, 6)), (1, (4, 5)), (2, (4, 5)), (0, (0, 0)), (3, (5, 4))],
)  # fmt: skip
def test_what_does_not_fit_is_refused(index, wrong):
    tensors = [*drawn(4, 5, 1.0, 0), torch.zeros(4, 5)]
    tensors[index] = torch.zeros(wrong)
    values, across, down, smoothed = tensors
    with pytest.raises(ValueError, match="wrong shape"):
        _ext.diffuse(values, across, down, 2, smoothed)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_other_precision_is_refused(index):
    tensors = list(drawn(4, 5, 1.0, 0))
    tensors[index] = tensors[index].double()
    values, across, down = tensors
    with pytest.raises(ValueError, match="float32"):
        diffusion.diffused(values, across, down, 2)


@pytest.mark.parametrize("with_prior", [False, True])
def test_a_photo_is_completed_as_by_the_reference(with_prior):
    """Float32 against float32: guidance by L1 takes rounding to other sides of a kink, so not against float64."""
    g = torch.Generator().manual_seed(3)
    image = 0.1 * torch.rand(30, 41, 3, generator=g)
    image[8:20, 10:30] += 0.7
    truth = torch.full((30, 41), 3.0)
    truth[8:20, 10:30] = 2.0
    prior = (0.5 * torch.rand(30, 41, generator=g) + 0.2) if with_prior else None
    at = torch.randperm(30 * 41, generator=g)[:25]
    rows, columns = at // 41, at % 41
    sparse = depth_adaptation.SparseDepths(rows=rows, columns=columns, depths=truth[rows, columns])
    nothing = torch.zeros(30, 41)
    found = [
        depth_adaptation.adapt_view(
            denoiser, image, sparse, nothing, nothing.bool(),
            depth_adaptation.AdaptationSettings(guidance_steps=8), torch.Generator().manual_seed(0),
        )
        for denoiser in (EdgeDiffusion(prior=prior), PhotoDiffusion(image, prior))
    ]  # fmt: skip
    assert float((found[0] - found[1]).abs().max()) < 1e-4
