"""What attention reads, and its gated projections, against the reference's, gradients included."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.methods.dlg_gs.gates import attention_inputs, gated_projections
from splatproof.reference.anchors import attention as reference
from splatproof.reference.anchors import scaffold

D = torch.float64
LOW, HIGH = torch.tensor([-1.0, -2.0, 0.5]), torch.tensor([1.0, 3.0, 1.5])
EXTENT = 1.7
CODE = {D: 1e-14, torch.float32: 8e-6}
"""How far the code may be off: 16 pi, the largest argument, rounded (6e-6 in float32), in the reference as in the twin."""


def told(centres, eye):
    """The inputs, by the reference."""
    low, high = LOW.to(centres), HIGH.to(centres)
    code = reference.fourier_code(reference.in_box(centres, low, high))
    direction, distance = scaffold.view_code(centres, eye)
    return torch.cat([code, direction, distance / EXTENT], dim=1)


@given(n=st.integers(0, 40), seed=st.integers(0, 2**16), dtype=st.sampled_from([D, torch.float32]))
@settings(max_examples=40)
def test_inputs_are_the_references(n, seed, dtype):
    """Of anchors inside the box and outside, and of one where the camera is."""
    g = torch.Generator().manual_seed(seed)
    centres = 2 * torch.randn(n, 3, generator=g, dtype=dtype)
    eye = torch.randn(3, generator=g, dtype=D)
    if n > 1:
        centres[0] = eye
    found = attention_inputs(centres, LOW.to(dtype), HIGH.to(dtype), eye, EXTENT)
    assert_close(found[:, :24], told(centres, eye)[:, :24], atol=CODE[dtype], rtol=0)
    assert_close(found[:, 24:], told(centres, eye)[:, 24:], atol=CODE[dtype] / 8, rtol=0)


def test_a_box_without_extent_is_refused():
    with pytest.raises(ValueError, match="box without extent"):
        attention_inputs(torch.zeros(2, 3), LOW, LOW, torch.zeros(3), EXTENT)


def weights(seed, kernels, dtype):
    """Weights that differ from those at the start, with gradients."""
    g = torch.Generator().manual_seed(seed)
    made = vars(reference.create(28, 5, g, dtype))
    for name, length in zip(("anchor_kernel", "feature_kernel"), kernels, strict=True):
        made[name] = torch.randn(length, generator=g, dtype=dtype)
    return reference.AttentionWeights(**{n: t.requires_grad_() for n, t in made.items()})


@given(
    n=st.integers(1, 40), seed=st.integers(0, 2**16), kernels=st.sampled_from([(1, 3), (3, 5)]),
    dtype=st.sampled_from([D, torch.float32]),
)  # fmt: skip
@settings(max_examples=40)
def test_projections_and_their_gradients_are_the_references(n, seed, kernels, dtype):
    g = torch.Generator().manual_seed(seed)
    inputs = torch.randn(28, n, generator=g, dtype=dtype).T
    parts = weights(seed, kernels, dtype)
    given_back = [torch.randn(n, 5, generator=g, dtype=dtype) for _ in range(3)]
    ours = gated_projections(inputs, parts)
    gated = reference.pooled_gates(inputs, parts)
    want = [gated @ parts.query / math.sqrt(5), gated @ parts.key, gated @ parts.value]
    rtol, atol = (1e-4, 2e-5) if dtype == torch.float32 else (1e-10, 1e-12)
    assert_close(list(ours), want, rtol=rtol, atol=atol)
    tensors = [*vars(parts).values()]
    for found, by in zip(
        torch.autograd.grad(ours, tensors, given_back),
        torch.autograd.grad(want, tensors, given_back),
        strict=True,
    ):
        assert_close(found, by, rtol=rtol, atol=atol)


def test_inputs_with_a_gradient_are_refused():
    with pytest.raises(ValueError, match="detach"):
        gated_projections(torch.zeros(2, 28, requires_grad=True), weights(0, (1, 3), torch.float32))
