"""The native harmonics of our small file against the file's own codes, in double, and against torch's."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.stored_harmonics import stored_harmonics
from splatproof.methods.storage.packed.straight_through import stored_harmonics_torch
from splatproof.reference.compression import quantisers
from splatproof.reference.compression.quantisers import OPPONENT, WIDEST, Steps

STEPS = Steps(position=0.01, log_scale=0.1, opacity=0.1, rotation_bits=8, dc=0.05, harmonics=0.04,
              weights=(-50_686, -2_097, 26, 754, -786, -2_490))  # fmt: skip
"""Steps and weights of the order that files have; scales and opacities below reach all seven classes."""
HALF_WAY = 1e-3
"""Distance from a half, in codes, up to which float32 may round to the other side."""


def drawn(count: int, coefficients: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    rest = 0.3 * torch.randn(count, coefficients, 3, generator=g)
    return rest, 3 * torch.randn(count, 3, generator=g) - 4, 4 * torch.randn(count, generator=g)


def in_the_file(rest: Tensor, log_scales: Tensor, logits: Tensor) -> tuple[Tensor, Tensor]:
    """What a reader of the file gets, in double, and which numbers lie half-way between two codes."""
    scales = quantisers.uniform("scale", log_scales.double().numpy(), STEPS.log_scale)
    opacity = quantisers.uniform("opacity", logits.double().numpy(), STEPS.opacity)
    found = quantisers.classes(scales, opacity, STEPS.weights)
    step = np.ldexp(STEPS.harmonics, found - WIDEST)[:, None, None]
    places = rest.double().numpy() @ OPPONENT.T / step
    near = np.abs(places - np.floor(places) - 0.5) < HALF_WAY
    values = np.rint(places) * step @ OPPONENT
    return torch.from_numpy(values), torch.from_numpy(near.any(axis=2, keepdims=True))


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    count=st.integers(0, 1100),
    coefficients=st.sampled_from([0, 3, 8, 15, 17]),
    seed=st.integers(0, 2**16),
)
def test_it_is_what_the_file_gives_back(simd_level, count, coefficients, seed):
    rest, log_scales, logits = drawn(count, coefficients, seed)
    want, unsure = in_the_file(rest, log_scales, logits)
    got = stored_harmonics(rest, log_scales, logits, STEPS).double()
    off = (got - want).abs() / (1 + want.abs())
    assert not off.where(~unsure, 0).numel() or float(off.where(~unsure, 0).max()) < 1e-6
    if unsure.any():
        assert float(unsure.double().mean()) < 0.05


def test_all_classes_are_reached_and_another_class_would_be_seen():
    rest, log_scales, logits = drawn(2000, 3, 0)
    codes = [quantisers.uniform("x", v.double().numpy(), 0.1) for v in (log_scales, logits)]
    found = quantisers.classes(codes[0], codes[1], STEPS.weights)
    assert set(found.tolist()) == set(range(7))
    coarser = replace(STEPS, harmonics=2 * STEPS.harmonics)
    other = stored_harmonics(rest, log_scales, logits, coarser)
    assert float((other - stored_harmonics(rest, log_scales, logits, STEPS)).abs().max()) > 0.01


def test_what_is_stored_is_stored_again_as_it_is(simd_level):
    rest, log_scales, logits = drawn(300, 15, 1)
    once = stored_harmonics(rest, log_scales, logits, STEPS)
    again = stored_harmonics(once, log_scales, logits, STEPS)
    torch.testing.assert_close(again, once, rtol=0, atol=1e-6)


def test_gradients_pass_and_torch_in_double_says_the_same():
    rest, log_scales, logits = drawn(200, 15, 2)
    mine, theirs = rest.clone().requires_grad_(), rest.double().requires_grad_()
    weight = torch.randn(rest.shape, generator=torch.Generator().manual_seed(3))
    got = stored_harmonics(mine, log_scales, logits, STEPS)
    want = stored_harmonics_torch(theirs, log_scales.double(), logits.double(), STEPS)
    (found,) = torch.autograd.grad((got * weight).sum(), mine)
    (right,) = torch.autograd.grad((want * weight).sum(), theirs)
    torch.testing.assert_close(found.double(), right, rtol=0, atol=1e-6)
    assert torch.equal(found, weight)
    assert float(((got - want).abs() > 1e-5).double().mean()) < 1e-3


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e30])
def test_what_is_no_number_stays_with_its_gaussian(simd_level, bad):
    """And a scale or an opacity that is none decides some class, not one beyond the seven."""
    rest, log_scales, logits = drawn(40, 15, 4)
    plain = stored_harmonics(rest, log_scales, logits, STEPS)
    rest[7, 3, 1] = log_scales[9, 0] = logits[11] = bad
    found = stored_harmonics(rest, log_scales, logits, STEPS)
    others = [i for i in range(40) if i not in (7, 9, 11)]
    assert torch.equal(found[others], plain[others])
    assert found[[9, 11]].isfinite().all()
    assert float((found[[9, 11]] - rest[[9, 11]]).abs().max()) < 8 * STEPS.harmonics


@pytest.mark.parametrize(
    ("index", "wrong"),
    [(0, (4, 15, 2)), (1, (4, 2)), (1, (5, 3)), (2, (3,)), (3, (5,)), (4, (4, 14, 3))],
)
def test_what_does_not_fit_is_refused(index, wrong):
    tensors = [*drawn(4, 15, 0), torch.tensor(STEPS.weights), torch.zeros(4, 15, 3)]
    tensors[index] = torch.zeros(wrong, dtype=tensors[index].dtype)
    rest, log_scales, logits, weights, stored = tensors
    with pytest.raises(ValueError, match="wrong shape"):
        _ext.store_harmonics(rest, log_scales, logits, 0.1, 0.1, 0.04, weights, stored)


@pytest.mark.parametrize(
    ("log_scale", "opacity", "harmonics"),
    [(0.0, 0.1, 0.04), (0.1, -1.0, 0.04), (0.1, 0.1, float("nan"))],
)
def test_steps_are_above_0(log_scale, opacity, harmonics):
    rest, log_scales, logits = drawn(4, 15, 0)
    weights = torch.tensor(STEPS.weights)
    with pytest.raises(ValueError, match="not above 0"):
        _ext.store_harmonics(
            rest, log_scales, logits, log_scale, opacity, harmonics, weights, torch.zeros(4, 15, 3)
        )


@pytest.mark.parametrize("index", [0, 1, 2])
def test_other_precision_is_refused(index):
    tensors = list(drawn(4, 15, 0))
    tensors[index] = tensors[index].double()
    rest, log_scales, logits = tensors
    with pytest.raises(ValueError, match="float32"):
        stored_harmonics(rest, log_scales, logits, STEPS)
