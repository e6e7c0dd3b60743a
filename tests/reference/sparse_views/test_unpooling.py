"""Unpooling: by hand, invariances, few points, the bound on their number."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatproof.reference.sparse_views.unpooling import NEIGHBOURS, nearest_others, unpooled


def points(count: int, seed: int) -> Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)).double()


def test_four_points_by_hand():
    means = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 0, 0]])
    distances, rows = nearest_others(means)
    assert rows[0].tolist() == [1, 2, 3]
    assert rows[3].tolist() == [1, 0, 2]
    made = unpooled(means, distances, rows, threshold=8.0)  # only the far one is so lonely
    assert made.destinations.tolist() == [1, 0, 2]
    assert made.means.tolist() == [[5, 0, 0], [4.5, 0, 0], [4.5, 0.5, 0]]


@given(count=st.integers(0, 30), seed=st.integers(0, 2**16), threshold=st.floats(0, 3))
def test_every_lonely_gaussian_gives_one_to_each_neighbour_half_way(count, seed, threshold):
    means = points(count, seed)
    distances, rows = nearest_others(means)
    made = unpooled(means, distances, rows, threshold)
    kept = min(NEIGHBOURS, max(0, count - 1))
    lonely = int((distances.mean(dim=1) > threshold).sum()) if kept else 0
    assert len(made.means) == lonely * kept
    sources = 2 * made.means - means[made.destinations]  # mirrored at the new one
    if len(sources):
        assert torch.cdist(sources, means).amin(dim=1).max() < 1e-6


@given(seed=st.integers(0, 2**16), scale=st.floats(0.01, 100), move=st.floats(-50, 50))
def test_another_unit_and_origin_change_nothing(seed, scale, move):
    means = points(20, seed)
    one = unpooled(means, *nearest_others(means), threshold=0.8)
    moved = scale * means + move
    other = unpooled(moved, *nearest_others(moved), threshold=0.8 * scale)
    assert torch.equal(one.destinations, other.destinations)
    torch.testing.assert_close(other.means, scale * one.means + move)


@given(seed=st.integers(0, 2**16), most=st.integers(0, 40))
def test_a_bound_takes_the_loneliest(seed, most):
    means = points(25, seed)
    found = nearest_others(means)
    free, bound = (unpooled(means, *found, threshold=0.3, most=m) for m in (None, most))
    assert len(bound.means) <= most
    assert torch.equal(bound.destinations, free.destinations[: len(bound.destinations)])
    assert len(bound.means) > most - NEIGHBOURS or len(bound.means) == len(free.means)


def test_duplicates_are_near_and_never_themselves():
    means = torch.zeros(5, 3)
    distances, rows = nearest_others(means)
    assert not distances.any()
    assert not (rows == torch.arange(5)[:, None]).any()
    assert len(unpooled(means, distances, rows, threshold=0.0).means) == 0
