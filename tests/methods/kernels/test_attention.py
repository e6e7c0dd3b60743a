"""The native attention against the masked dense one in float64: what is mixed, and every gradient."""

import math
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof import _ext
from splatproof.methods.dlg_gs.neighbours import neighbours
from splatproof.methods.kernels import attention as native

BOUND = 5e-6
"""Largest error of what is mixed, and of a gradient as a share of the tensor's largest number (absolute below 1). Over
1,200 cases at all SIMD levels the largest was 2.1e-6."""


def drawn(
    n: int, taking: int, width: int, out: int, seed: int
) -> tuple[Tensor, Tensor, list[Tensor]]:
    """Places of all anchors, who takes part, and query, key and value of those."""
    g = torch.Generator().manual_seed(seed)
    rows = torch.randperm(n, generator=g)[: min(n, taking)].sort().values
    sizes = (width, width, out)
    return (
        torch.rand(n, 3, generator=g),
        rows,
        [torch.randn(len(rows), c, generator=g) for c in sizes],
    )


def dense(centres: Tensor, tensors: list[Tensor], radius: float) -> Tensor:
    """The definition, of those that take part."""
    query, key, value = tensors
    # distances as the kernels take them, in float32: a pair at the radius must not be decided by the dtype
    apart = (centres[:, None] - centres[None]).norm(dim=-1)
    seen = (apart <= radius) | torch.eye(len(centres), dtype=torch.bool)
    scores = query @ key.T / math.sqrt(key.shape[1])
    return torch.softmax(torch.where(seen, scores, -torch.inf), dim=1) @ value


def test_a_query_that_is_scaled_already_is_taken_as_it_is():
    g = torch.Generator().manual_seed(3)
    lists, every = neighbours(torch.rand(9, 3, generator=g), 0.6).native, torch.arange(9)
    query, key, value = (torch.randn(9, 4, generator=g) for _ in range(3))
    want = native.attend(lists, every, query, key, value)
    assert torch.equal(native.attend(lists, every, query / 2, key, value, scaled=True), want)


def errors(
    centres: Tensor, rows: Tensor, tensors: list[Tensor], radius: float, slack: float
) -> list[float]:
    near = neighbours(centres, radius + slack).native
    exact = [t.double().requires_grad_() for t in tensors]
    mine = [t.clone().requires_grad_() for t in tensors]
    want = dense(centres[rows], exact, radius)
    looked: dict[str, Any] = {"centres": centres, "radius": radius} if slack else {}
    got = native.attend(near, rows, *mine, **looked)
    weight = torch.randn(want.shape, generator=torch.Generator().manual_seed(1))
    right = torch.autograd.grad((want * weight).sum(), exact)
    found = torch.autograd.grad((got * weight).sum(), mine)
    pairs = [(want.detach(), got.detach()), *zip(right, found, strict=True)]
    return [
        float((b.double() - a).abs().max() / a.abs().max().clamp(min=1)) if a.numel() else 0.0
        for a, b in pairs
    ]


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    n=st.integers(0, 60), taking=st.integers(0, 60), width=st.sampled_from([1, 7, 16, 28, 33]),
    out=st.sampled_from([1, 16, 28, 40]), radius=st.floats(0, 1.5),
    slack=st.sampled_from([0.0, 0.2]), seed=st.integers(0, 2**20),
)  # fmt: skip
def test_it_is_the_definition(simd_level, n, taking, width, out, radius, slack, seed):
    centres, rows, tensors = drawn(n, taking, width, out, seed)
    assert max(errors(centres, rows, tensors, radius, slack)) <= BOUND


def test_anchors_that_see_hundreds(simd_level):
    centres, rows, tensors = drawn(400, 300, 28, 28, 3)
    assert max(errors(centres, rows, tensors, 2.0, 0.0)) <= BOUND


def test_scores_that_exp_cannot_hold_do_no_harm(simd_level):
    centres, rows, (query, key, value) = drawn(40, 30, 8, 8, 4)
    assert (
        max(errors(centres, rows, [40 * query, key, value], 0.8, 0.0)) <= 1e-4
    )  # of scores of 200


def test_who_sees_nobody_else_passes_its_value_on(simd_level):
    centres, rows, tensors = drawn(9, 9, 28, 28, 5)
    near = neighbours(centres, 5.0).native
    got = native.attend(near, rows, *tensors, centres=centres, radius=0.0)
    assert torch.equal(got, tensors[2])


def test_bits_do_not_depend_on_threads():
    centres, rows, tensors = drawn(700, 500, 28, 28, 6)
    near, leaves = neighbours(centres, 0.3).native, [t.requires_grad_() for t in tensors]
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            mixed = native.attend(near, rows, *leaves, centres=centres, radius=0.2)
            found.append([mixed, *torch.autograd.grad(mixed.cos().sum(), leaves)])
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_what_it_cannot_do_is_refused():
    centres, rows, (query, key, value) = drawn(6, 4, 8, 8, 7)
    near = neighbours(centres, 0.5).native
    with pytest.raises(ValueError, match=r"torch\.float32 on the CPU"):
        native.attend(near, rows, query.double(), key, value)
    for name, (q, k, v, r, c) in {
        "key": (query, key[:, :7].contiguous(), value, rows, None),
        "value": (query, key, value[:3], rows, None),
        "rows": (query, key, value, rows[:3], None),
        "centres": (query, key, value, rows, centres[:5]),
    }.items():
        with pytest.raises(ValueError, match=f"{name} has the wrong shape"):
            _ext.Attended(near, q, k, v, r, c, 0.1)
    state = _ext.Attended(near, query, key, value, rows, None, math.inf)
    with pytest.raises(ValueError, match="what was mixed has the wrong shape"):
        _ext.attend_backward(state, value, query, key, value)
    with pytest.raises(ValueError, match="mixed has the wrong shape"):
        _ext.attend(state, value[:3])
    with pytest.raises(ValueError, match="gradient by key has the wrong shape"):
        _ext.attend_backward(state, value, query, key[:3], value)
    with pytest.raises(ValueError, match=r"rows\[3\] is 6"):
        native.attend(near, torch.tensor([0, 1, 2, 6]), query, key, value)
    with pytest.raises(ValueError, match=r"rows\[1\] is 0"):
        native.attend(near, torch.tensor([0, 0, 2, 3]), query, key, value)
    with pytest.raises(ValueError, match=r"targets\[1\] is 2"):
        native.lists(torch.tensor([0, 1]), torch.tensor([0, 2]))
    with pytest.raises(ValueError, match=r"starts\[1\] is 3"):
        native.lists(torch.tensor([0, 3]), torch.tensor([0, 1]))
    with pytest.raises(ValueError, match="begin with 0"):
        native.lists(torch.tensor([1, 1]), torch.tensor([0, 1]))
