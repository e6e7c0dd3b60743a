"""Neighbours and features of the consistency step, against the reference's loops."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.methods.hdgs.consistency import Pairs, pairs, supported
from splatproof.reference.anchors import sparse_convolution, support_network
from splatproof.reference.types import mlp

F64 = torch.float64


def sites(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    cells = torch.unique(torch.randint(-3, 4, (count, 3), generator=generator), dim=0)
    inside = torch.rand(len(cells), 3, generator=generator) * 0.98 + 0.01
    order = torch.randperm(len(cells), generator=generator)
    return ((cells + inside) * 0.5).to(F64)[order]


def table(near: Pairs, count: int) -> torch.Tensor:
    found = torch.full((count, 27), -1)
    starts = (0, *near.ends[:-1])
    for cell, (start, end) in enumerate(zip(starts, near.ends, strict=True)):
        found[near.sites[start:end], cell] = near.neighbours[start:end]
    return found


@settings(max_examples=25, deadline=None)
@given(count=st.integers(0, 60), seed=st.integers(0, 99))
def test_pairs_are_the_references_neighbours(count, seed):
    centres = sites(count, seed)
    want = sparse_convolution.neighbours(sparse_convolution.voxelise(centres, 0.5))
    assert torch.equal(table(pairs(centres, 0.5), len(centres)), want)


def test_neighbours_of_scattered_sites_far_from_the_origin_are_not_mixed_up():
    far = torch.tensor([[5e4, -2e4, 30.0], [5e4, -2e4, 30.6], [-5e4, 2e4, -30.0]], dtype=F64)
    assert pairs(far, 0.5).ends[-1] == 5  # three sites and one pair in both directions


def test_two_sites_in_a_voxel_are_refused():
    with pytest.raises(ValueError, match="merge them first"):
        pairs(torch.tensor([[0.1, 0, 0], [0.2, 0, 0]]), 0.5)


def arguments(seed: int):
    generator = torch.Generator().manual_seed(seed)
    centres = sites(50, seed)
    count = len(centres)
    network = support_network.create(6, generator, F64)
    network = replace(network, residual=mlp.create((6, 6), generator, F64))
    features, quaternions, scales = (
        torch.randn(count, width, generator=generator).to(F64) for width in (6, 4, 3)
    )
    return network, features, centres, quaternions, scales.exp()


def test_all_of_it_is_the_reference_and_so_are_its_gradients():
    network, features, centres, quaternions, scales = arguments(1)
    inputs = [features, quaternions, scales, network.convolution, network.modulation.weights[0]]
    for value in inputs:
        value.requires_grad_()
    want = support_network.support(network, features, centres, quaternions, scales, 0.5)
    everything = torch.arange(len(centres))
    near = pairs(centres, 0.5)
    found = supported(network, features, centres, quaternions, scales, near, everything)
    torch.testing.assert_close(found, want)
    pull = torch.randn(want.shape, generator=torch.Generator().manual_seed(2)).to(F64)
    for one, other in zip(
        torch.autograd.grad((found * pull).sum(), inputs),
        torch.autograd.grad((want * pull).sum(), inputs),
        strict=True,
    ):
        torch.testing.assert_close(one, other)


def test_those_asked_for_get_what_they_would_among_all():
    network, features, centres, quaternions, scales = arguments(3)
    near, seen = pairs(centres, 0.5), torch.tensor([7, 2, 30])
    some, everyone = (
        supported(network, features, centres, quaternions, scales, near, rows)
        for rows in (seen, torch.arange(len(centres)))
    )
    torch.testing.assert_close(some, everyone[seen])


@pytest.mark.parametrize("ice", ["off", "conv", "no-mod", "no-gate"])
def test_parts_left_out(ice):
    network, features, centres, quaternions, scales = arguments(4)
    around = sparse_convolution.neighbours(sparse_convolution.voxelise(centres, 0.5))
    mixed = sparse_convolution.convolve(features, around, network.convolution)
    if ice == "no-gate":  # a gate of one: the reference without its sigmoid's influence
        wide = mlp.change(network.gate, torch.zeros_like)
        wide = replace(wide, biases=(wide.biases[0], torch.full((1,), 50.0, dtype=F64)))
        ungated = replace(network, gate=wide)
        want = support_network.support(ungated, features, centres, quaternions, scales, 0.5)
    else:
        gate = torch.sigmoid(mlp.evaluate(network.gate, mixed)) if ice == "no-mod" else 1.0
        want = features + (ice != "off") * gate * mlp.evaluate(network.residual, mixed)
    rows = torch.arange(len(centres))
    found = supported(
        network, features, centres, quaternions, scales, pairs(centres, 0.5), rows, ice
    )
    torch.testing.assert_close(found, want)
