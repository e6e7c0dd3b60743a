"""The trees give what all distances give."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.methods.sparse_views import nearest
from splatproof.reference.sparse_views import co_pruning, unpooling


@given(count=st.integers(0, 40), seed=st.integers(0, 2**16))
def test_neighbours(count, seed):
    means = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)).double()
    have, want = nearest.nearest_others(means), unpooling.nearest_others(means)
    torch.testing.assert_close(have[0], want[0])
    assert torch.equal(have[1], want[1])


@given(count=st.integers(1, 12), copies=st.integers(1, 4), seed=st.integers(0, 2**16))
def test_neighbours_of_duplicates_are_others(count, copies, seed):
    generator = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=generator).double().repeat(copies, 1)
    have, want = nearest.nearest_others(means), unpooling.nearest_others(means)
    torch.testing.assert_close(have[0], want[0])
    assert not (have[1] == torch.arange(len(means))[:, None]).any()
    again = (means[have[1]] - means[:, None]).norm(dim=2)
    torch.testing.assert_close(again, have[0], atol=1e-12, rtol=0)


@given(
    count=st.integers(0, 25), others=st.integers(0, 25), seed=st.integers(0, 2**16),
    distance=st.floats(0, 2),
)  # fmt: skip
def test_matches(count, others, seed, distance):
    generator = torch.Generator().manual_seed(seed)
    one, other = (torch.rand(n, 3, generator=generator).double() for n in (count, others))
    want = co_pruning.matched(one, other, distance)
    assert torch.equal(nearest.matched(one, other, distance), want)
