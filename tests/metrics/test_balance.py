"""Load balance by hand, and what must hold for any loads."""

import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.metrics.balance import spread

LOADS = st.lists(st.floats(0, 1e6), min_size=1, max_size=20).filter(lambda x: sum(x) > 1e-3)


def test_worked_by_hand():
    """Loads 1, 2, 3: mean 2, std sqrt(2/3)."""
    assert spread(np.array([1.0, 2.0, 3.0])) == pytest.approx((math.sqrt(2 / 3) / 2, 1.5))


@given(LOADS)
def test_agrees_with_the_statistics_module(loads):
    mean = statistics.fmean(loads)
    want = statistics.pstdev(loads) / mean, max(loads) / mean
    assert spread(np.array(loads)) == pytest.approx(want, rel=1e-9, abs=1e-9)


@given(LOADS, st.floats(0.1, 10), st.randoms(use_true_random=False))
def test_order_and_unit_do_not_matter(loads, unit, random):
    shuffled = [unit * load for load in loads]
    random.shuffle(shuffled)
    assert spread(np.array(shuffled)) == pytest.approx(spread(np.array(loads)), rel=1e-9, abs=1e-9)


@given(LOADS)
def test_bounds(loads):
    std, most = spread(np.array(loads))
    count = len(loads)
    assert 1 <= most * (1 + 1e-12) <= count * (1 + 1e-9)
    assert 0 <= std <= math.sqrt(count - 1) * (1 + 1e-9)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_equal_loads_and_one_block_with_all(count):
    assert spread(np.full(count, 3.0)) == (0, 1)
    alone = np.zeros(count)
    alone[-1] = 5.0
    assert spread(alone) == pytest.approx((math.sqrt(count - 1), count))


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        ([], "no blocks"),
        ([0.0, 0.0], "all 2 blocks have no load"),
        ([1.0, -2.0], "block 1 has the load -2"),
        ([math.nan, 1.0], "block 0 has the load nan"),
        ([1.0, math.inf], "block 1 has the load inf"),
    ],
)
def test_bad_loads_are_refused(loads, said):
    with pytest.raises(DataError, match=said):
        spread(np.array(loads, dtype=np.float64))
