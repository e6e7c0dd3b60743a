"""The native field against its reference in float64: values, and every gradient."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof.methods.kernels import field as native
from splatproof.reference.layered_memory import coordinate_field
from splatproof.reference.layered_memory.coordinate_field import CoordinateField

BOUND = 1e-5
"""Largest error of a value, and of a gradient as a share of the tensor's largest number (absolute below 1), of the
network's at least of the root of the number of places: it is a sum over all of them, and where a network has one
hidden unit nothing else of its tensor is large when that sum cancels (3e-5 of such a sum was found). Over 180 cases
at all SIMD levels the largest was 1.8e-6."""


def drawn(
    count: int, sides: tuple[int, ...], width: int, outputs: int, seed: int
) -> tuple[Tensor, list[Tensor]]:
    """Places, some of them outside the box and on its faces; grids and network."""
    g = torch.Generator().manual_seed(seed)
    places = 1.6 * torch.rand(count, 3, generator=g) - 0.3
    places[::7] = places[::7].round()
    grids = [torch.randn(n, n, n, 4, generator=g) for n in sides]
    network = [
        torch.randn(16, width, generator=g) / 4, 0.3 * torch.randn(width, generator=g),
        torch.randn(width, outputs, generator=g) / width**0.5, torch.randn(outputs, generator=g),
    ]  # fmt: skip
    return places, [*grids, *network]


def in_reference(places: Tensor, tensors: list[Tensor]) -> Tensor:
    grids = tuple(grid.permute(3, 0, 1, 2)[None] for grid in tensors[:4])
    hidden, hidden_bias, out, out_bias = tensors[4:]
    field = CoordinateField(
        low=places.new_zeros(3), high=places.new_ones(3), grids=grids, hidden=hidden,
        hidden_bias=hidden_bias, out=out, out_bias=out_bias,
    )  # fmt: skip
    return coordinate_field.evaluate(field, places)


def errors(places: Tensor, tensors: list[Tensor]) -> list[float]:
    exact = [t.double().requires_grad_() for t in tensors]
    mine = [t.clone().requires_grad_() for t in tensors]
    want = in_reference(places.double(), exact)
    got = native.evaluate(places, mine[:4], mine[4:])
    weight = torch.randn(want.shape, generator=torch.Generator().manual_seed(1))
    right = torch.autograd.grad((want * weight).sum(), exact)
    found = torch.autograd.grad((got * weight).sum(), mine)
    pairs = [(want.detach(), got.detach()), *zip(right, found, strict=True)]
    summed = max(1.0, len(places) ** 0.5)
    least = [1.0] * (1 + len(mine[:4])) + [summed] * len(mine[4:])
    return [
        float((b.double() - a).abs().max() / a.abs().max().clamp(min=low)) if a.numel() else 0.0
        for (a, b), low in zip(pairs, least, strict=True)
    ]


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    count=st.integers(0, 1200), sides=st.tuples(*[st.integers(2, 9)] * 4),
    width=st.sampled_from([1, 16, 24, 32, 40]), outputs=st.integers(1, 16),
    seed=st.integers(0, 2**16),
)  # fmt: skip
def test_agrees_with_the_reference(simd_level, count, sides, width, outputs, seed):
    assert max(errors(*drawn(count, sides, width, outputs, seed))) < BOUND


def test_the_bound_sees_a_lost_place():
    places, tensors = drawn(300, (3, 4, 5, 6), 32, 9, 0)
    grids, network = tensors[:4], tensors[4:]
    moved = places.clone()
    moved[0] += 0.01
    worst = (native.evaluate(places, grids, network) - native.evaluate(moved, grids, network)).abs()
    assert float(worst.max()) > BOUND


def test_the_same_bits_for_any_number_of_threads():
    places, tensors = drawn(5000, (4, 8, 16, 32), 32, 9, 3)
    found = []
    for threads in (1, 2, 3):
        mine = [t.clone().requires_grad_() for t in tensors]
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        values = native.evaluate(places, mine[:4], mine[4:])
        found.append([values, *torch.autograd.grad(values.square().sum(), mine)])
        torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_a_place_that_is_no_number_reads_the_first_sample():
    """As little as an infinite parameter may it read beyond the grid."""
    places, tensors = drawn(3, (2, 2, 2, 2), 8, 9, 1)
    corner = torch.zeros_like(places)
    strange = torch.tensor([[torch.nan] * 3, [-torch.inf] * 3, [-1e30] * 3])
    asked = [native.evaluate(p, tensors[:4], tensors[4:]) for p in (strange, corner)]
    assert torch.equal(*asked)


@pytest.mark.parametrize(
    ("index", "wrong"),
    [(0, torch.zeros(1, 1, 1, 4)), (3, torch.zeros(4, 4, 5, 4)), (4, torch.zeros(15, 8)),
     (6, torch.zeros(8, 17)), (7, torch.zeros(8)), (1, torch.zeros(4, 4, 4, 4).double())],
)  # fmt: skip
def test_what_does_not_fit_is_refused(index, wrong):
    places, tensors = drawn(5, (2, 3, 4, 5), 8, 9, 1)
    tensors[index] = wrong
    with pytest.raises(ValueError, match=r"wrong shape|float32"):
        native.evaluate(places, tensors[:4], tensors[4:])
