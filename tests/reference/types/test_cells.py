"""Kinds of rows against torch's own, which is slow."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.reference.types.cells import unique_rows

NUMBERS = st.one_of(st.integers(-3, 3), st.integers(-(2**62), 2**62))


@given(
    width=st.integers(1, 4),
    data=st.data(),
    many=st.integers(0, 30),
    numbers=st.sampled_from([st.integers(-3, 3), st.integers(-(2**40), 2**40), NUMBERS]),
)
def test_as_torch_has_them(width, data, many, numbers):
    rows = data.draw(st.lists(st.lists(numbers, min_size=width, max_size=width), max_size=many))
    table = torch.tensor(rows, dtype=torch.int64).reshape(-1, width)
    kinds, which = torch.unique(table, dim=0, return_inverse=True)
    found, mine = unique_rows(table)
    assert torch.equal(found, kinds)
    assert torch.equal(mine, which)


@pytest.mark.parametrize("far", [3, 2**61, 2**62])
def test_rows_that_span_more_than_64_bits_hold(far):
    table = torch.tensor([[far, 0, 1], [-far, 5, 1], [far, 0, 1], [0, -far, 7]])
    found, which = unique_rows(table)
    assert torch.equal(found[which], table)
    assert len(found) == 3
