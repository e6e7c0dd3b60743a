"""Attention by lists against the masked dense one; the lists against a matrix of distances."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.methods.dlg_gs.attention import attention_among, local_attention
from splatproof.methods.dlg_gs.neighbours import Neighbours, neighbours
from splatproof.reference.anchors import attention as reference

D = torch.float64
PARTS = ("sources", "targets", "reverse", "starts")


def anchors(n: int, seed: int) -> tuple[Tensor, Tensor, reference.AttentionWeights]:
    g = torch.Generator().manual_seed(seed)
    centres = torch.randn(n, 3, generator=g, dtype=D)
    features = torch.randn(n, 7, generator=g, dtype=D)
    return features, centres, reference.create(7, 5, g, D)


def pairs(found: Neighbours) -> list[tuple[int, int]]:
    return list(zip(found.sources.tolist(), found.targets.tolist(), strict=True))


@given(n=st.integers(1, 12), seed=st.integers(0, 2**16), radius=st.floats(0, 3))
@settings(max_examples=25)
def test_lists_hold_the_pairs_of_the_matrix_in_order_with_their_reverse(n, seed, radius):
    _, centres, _ = anchors(n, seed)
    found = neighbours(centres, radius)
    near = (centres[:, None] - centres[None]).norm(dim=-1) <= radius
    assert pairs(found) == [tuple(pair) for pair in near.nonzero().tolist()]
    assert torch.equal(found.sources[found.reverse], found.targets)
    assert torch.equal(found.targets[found.reverse], found.sources)
    assert torch.equal(found.starts.diff(), near.sum(dim=1)[:-1])


@given(n=st.integers(1, 12), seed=st.integers(0, 2**16), radius=st.floats(0, 2))
@settings(max_examples=25)
def test_narrowed_lists_are_those_made_of_what_is_left(n, seed, radius):
    _, centres, _ = anchors(n, seed)
    chosen = torch.arange(n)[::2]
    narrowed = neighbours(centres, 1.5 * radius).among(chosen).within(centres[chosen], radius)
    fresh = neighbours(centres[chosen], radius)
    assert all(torch.equal(getattr(narrowed, part), getattr(fresh, part)) for part in PARTS)


def test_anchors_in_one_place_and_none_at_all():
    found = neighbours(torch.zeros(3, 3), 0.0)
    assert len(pairs(found)) == 9
    assert not pairs(neighbours(torch.zeros(0, 3), 1.0))


def test_an_anchor_at_exactly_the_radius_is_a_neighbour():
    centres = torch.tensor([[0.1, 0, 0], [0.4, 0, 0]])
    assert (0, 1) in pairs(neighbours(centres, 0.3))
    assert (0, 1) in pairs(neighbours(centres, 1.0).within(centres, 0.3))


@given(n=st.integers(1, 12), seed=st.integers(0, 2**16), radius=st.floats(0, 3))
@settings(max_examples=25)
def test_attention_and_its_gradients_are_the_dense_ones(n, seed, radius):
    features, centres, weights = anchors(n, seed)
    given_back = torch.randn(n, 5, generator=torch.Generator().manual_seed(seed), dtype=D)
    tensors = [features, weights.query, weights.key, weights.value]
    for tensor in tensors:
        tensor.requires_grad_()
    ours = local_attention(features, neighbours(centres, radius), weights)
    dense = reference.local_attention(features, centres, radius, weights)
    assert_close(ours, dense)
    for found, want in zip(
        torch.autograd.grad(ours, tensors, given_back),
        torch.autograd.grad(dense, tensors, given_back),
        strict=True,
    ):
        assert_close(found, want)


@pytest.mark.parametrize("dtype", [D, torch.float32])
@pytest.mark.parametrize(("slack", "radius"), [(0.0, math.inf), (0.3, 0.9)])
def test_anchors_in_view_see_those_of_them_within_the_radius(dtype, slack, radius):
    features, centres, weights = anchors(30, 5)
    weights = reference.AttentionWeights(**{n: w.to(dtype) for n, w in vars(weights).items()})
    features, centres = features.to(dtype), centres.to(dtype)
    seen, reach = torch.arange(30)[::3], min(radius, 0.9)
    scaled = weights.query / math.sqrt(weights.key.shape[1])
    query, key, value = (features[seen] @ w for w in (scaled, weights.key, weights.value))
    lists = neighbours(centres, reach + slack)
    ours = attention_among(query, key, value, seen, lists, centres, radius)
    assert_close(ours, reference.local_attention(features[seen], centres[seen], reach, weights))


def test_scores_that_exp_cannot_hold_do_no_harm():
    features, centres, weights = anchors(6, 0)
    ours = local_attention(1e3 * features, neighbours(centres, 2.0), weights)
    assert_close(ours, reference.local_attention(1e3 * features, centres, 2.0, weights))


@pytest.mark.parametrize("n", [1, 6])
def test_radius_zero_passes_the_value_through(n):
    features, centres, weights = anchors(n, 3)
    got = local_attention(features, neighbours(centres, 0.0), weights)
    assert_close(got, features @ weights.value)
