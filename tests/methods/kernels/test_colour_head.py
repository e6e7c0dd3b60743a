"""The native colour head against the same in torch and float64: colours, and every gradient."""

from dataclasses import replace

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof.methods.kernels import colour_head as native
from splatproof.reference.anchors.lighting_appearance import mix_colours
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp

BOUND = 1e-5
"""Largest error of a colour, and of a gradient as a share of the tensor's largest number (absolute below 1). Over 200
cases at all SIMD levels the largest was 1.2e-6."""
NEAR = 1e-4
"""Gaussians with a unit this close to its bend, where rounding decides, have no weight in the loss."""


def drawn(m: int, n: int, one: int, two: int, seed: int) -> tuple[list[Tensor], Tensor]:
    """Colours, what an anchor gives, weights and biases; and the owners."""
    g = torch.Generator().manual_seed(seed)
    made = mlp.create((3, one, two, 4), g)
    tensors = [
        torch.rand(m, 3, generator=g), torch.randn(n, one, generator=g), *made.weights,
        *(0.3 * torch.randn(b.shape, generator=g) for b in made.biases[1:]),
    ]  # fmt: skip
    return tensors, torch.randint(0, n, (m,), generator=g).sort().values


def head_of(tensors: list[Tensor]) -> Mlp:
    _, _, first, second, third, second_bias, third_bias = tensors
    unread = torch.full((2, first.shape[1]), torch.nan).to(first)
    return Mlp(
        weights=(torch.cat([first, unread]), second, third),
        biases=(torch.zeros_like(first[0]), second_bias, third_bias),
    )  # fmt: skip


def in_torch(tensors: list[Tensor], owner: Tensor) -> tuple[Tensor, Tensor]:
    """The definition; and how far each Gaussian's units are from their bends."""
    colours, of_each, first, second, third, second_bias, third_bias = tensors
    one = colours @ first + of_each[owner]
    two = one.relu() @ second + second_bias
    out = torch.sigmoid(two.relu() @ third + third_bias)
    far = torch.cat([one, two], dim=1).detach().abs().amin(dim=1)
    return mix_colours(colours, out[:, :3], out[:, 3:]), far


def errors(tensors: list[Tensor], owner: Tensor) -> list[float]:
    exact = [t.double().requires_grad_() for t in tensors]
    mine = [t.clone().requires_grad_() for t in tensors]
    want, far = in_torch(exact, owner)
    got = native.adapt(mine[0], mine[1], owner, head_of(mine))
    g = torch.Generator().manual_seed(1)
    weight = torch.randn(want.shape, generator=g) * (far > NEAR)[:, None]
    right = torch.autograd.grad((want * weight).sum(), exact)
    found = torch.autograd.grad((got * weight).sum(), mine)
    pairs = [(want.detach(), got.detach()), *zip(right, found, strict=True)]
    return [
        float((b.double() - a).abs().max() / a.abs().max().clamp(min=1)) if a.numel() else 0.0
        for a, b in pairs
    ]


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    m=st.integers(0, 100), n=st.integers(1, 40), one=st.sampled_from([1, 8, 16, 17, 32, 40]),
    two=st.sampled_from([1, 5, 16, 32, 33]), seed=st.integers(0, 2**20),
)  # fmt: skip
def test_it_is_the_definition(simd_level, m, n, one, two, seed):
    assert max(errors(*drawn(m, n, one, two, seed))) <= BOUND


def test_many_gaussians_whose_gradients_are_added_in_parts(simd_level):
    assert max(errors(*drawn(5000, 300, 32, 32, 3))) <= BOUND


@pytest.mark.parametrize("anchors", [1, 3])
def test_anchors_with_more_gaussians_than_a_part_has(anchors):
    assert max(errors(*drawn(3000, anchors, 16, 8, 4))) <= BOUND


def test_bits_do_not_depend_on_threads():
    tensors, owner = drawn(3000, 200, 20, 24, 5)
    leaves = [t.requires_grad_() for t in tensors]
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            adapted = native.adapt(leaves[0], leaves[1], owner, head_of(leaves))
            found.append([adapted, *torch.autograd.grad(adapted.cos().sum(), leaves)])
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_what_it_cannot_do_is_refused():
    tensors, owner = drawn(10, 4, 8, 8, 6)
    head = head_of(tensors)
    assert native.applies(tensors[0], tensors[1], head)
    assert not native.applies(tensors[0].double(), tensors[1], head)
    short = replace(head, weights=head.weights[1:], biases=head.biases[1:])
    with pytest.raises(ValueError, match="three layers"):
        native.adapt(tensors[0], tensors[1], owner, short)
    wide = replace(head, weights=(*head.weights[:2], torch.zeros(8, 5)))
    with pytest.raises(ValueError, match="the third layer"):
        native.adapt(tensors[0], tensors[1], owner, wide)
    with pytest.raises(ValueError, match=r"owner\[1\] is 0"):
        native.adapt(tensors[0], tensors[1], torch.tensor([1, 0] + 8 * [3]), head)
    with pytest.raises(ValueError, match=r"owner\[9\] is 4"):
        native.adapt(tensors[0], tensors[1], torch.tensor(9 * [3] + [4]), head)
