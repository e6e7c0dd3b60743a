"""Co-pruning: identical and disjoint fields, units, and what distance does."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatproof.reference.sparse_views.co_pruning import matched


def fields(seed: int, count: int, others: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, 3, generator=generator), torch.rand(others, 3, generator=generator)


def test_by_hand():
    own = torch.tensor([[0.0, 0, 0], [3, 0, 0]])
    other = torch.tensor([[0.0, 1, 0]])
    assert matched(own, other, 1.0).tolist() == [True, False]
    assert matched(other, own, 1.0).tolist() == [True]
    assert matched(own, other[:0], 9.0).tolist() == [False, False]
    assert matched(own[:0], other, 9.0).tolist() == []


@given(seed=st.integers(0, 2**16), count=st.integers(1, 20))
def test_identical_fields_lose_nothing_and_far_ones_everything(seed, count):
    own, _ = fields(seed, count, 1)
    assert matched(own, own.flip(0), 0.0).all()
    assert not matched(own, own + 10, 5.0).any()


@given(seed=st.integers(0, 2**16), scale=st.sampled_from([0.125, 4.0, 64.0]))
def test_a_world_and_distance_k_times_as_large_keep_the_same(seed, scale):
    own, other = fields(seed, 15, 12)
    want = matched(own, other, 0.25)
    assert torch.equal(matched(scale * own, scale * other, scale * 0.25), want)


@given(seed=st.integers(0, 2**16), distance=st.floats(0, 1), more=st.floats(0, 1))
def test_a_larger_distance_keeps_more(seed, distance, more):
    own, other = fields(seed, 15, 12)
    near, far = (matched(own, other, d) for d in (distance, distance + more))
    assert (far | ~near).all()
