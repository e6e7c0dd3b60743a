"""The analytic interval: against the bootstrap at 95 %, against Student where both agree, and its p-value."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from splatproof.reports.comparing.estimate import Estimate, estimate
from splatproof.reports.statistics import paired_difference


def drawn(seed: int, seeds: int, images: int, noise: float = 0.05, own: float = 0.05):
    rng = np.random.default_rng(seed)
    hard = rng.normal(24, 3, images)
    return [
        hard + rng.normal(0, noise, (seeds, 1)) + rng.normal(0, own, images)
        + rng.normal(0, 0.02, (seeds, images))
        for _ in range(2)
    ]  # fmt: skip


@pytest.mark.parametrize(("seeds", "images"), [(3, 8), (6, 12), (10, 30)])
def test_it_is_the_bootstrap_where_that_can_be_asked(seeds: int, images: int):
    """Same mean; widths at 95 % that differ by the draws' scatter and by Cochran's caution."""
    ratios = []
    for draw in range(6):
        new, base = drawn(draw, seeds, images)
        ours = estimate(new, base)
        theirs = paired_difference([(new, base)], np.random.default_rng(0))
        assert ours.mean == pytest.approx(theirs.mean, abs=1e-12)
        low, high = ours.interval(0.05)
        ratios.append((high - low) / (theirs.high - theirs.low))
    # three seeds: Cochran's weights give up to 1.4 of Satterthwaite's width, as they must in the tail
    assert 0.93 < np.median(ratios) < (1.4 if seeds == 3 else 1.15), ratios


def test_with_one_value_a_run_it_is_welchs_test():
    rng = np.random.default_rng(3)
    new, base = rng.normal(1, 1, (5, 1)), rng.normal(0, 2, (7, 1))
    found = estimate(new, base)
    theirs = stats.ttest_ind(new[:, 0], base[:, 0], equal_var=False)
    assert found.p_value == pytest.approx(theirs[1], rel=1e-6)
    low, high = theirs.confidence_interval(0.99)
    assert found.interval(0.01) == pytest.approx((low, high))


@given(
    mean=st.floats(-3, 3), seeds=st.floats(1e-6, 1), images=st.floats(0, 1),
    freedoms=st.tuples(st.integers(1, 30), st.integers(1, 100)),
)  # fmt: skip
def test_the_p_value_is_the_level_at_which_the_interval_touches_0(mean, seeds, images, freedoms):
    found = Estimate(mean=mean, seed_variance=seeds, seed_freedom=float(freedoms[0]),
                     image_variance=images, image_freedom=float(freedoms[1]))  # fmt: skip
    p = found.p_value
    assert 0 <= p <= 1
    if 1e-12 < p < 0.99:
        low, high = found.interval(p)
        assert min(abs(low), abs(high)) == pytest.approx(0, abs=1e-5 * abs(mean))


@given(st.floats(1e-6, 0.5), st.floats(1.01, 10))
def test_more_confidence_is_a_wider_interval(alpha, factor):
    new, base = drawn(1, 3, 8)
    found = estimate(new, base)
    assert found.critical(alpha / factor) > found.critical(alpha)


def test_no_scatter_is_no_error():
    same = np.full((3, 4), 0.1)
    found = estimate(same, same)
    assert (found.mean, found.error, found.p_value) == (0.0, 0.0, 1.0)
    moved = estimate(same + 0.01, same)
    assert (moved.error, moved.p_value) == (0.0, 0.0)
    assert moved.interval(0.001) == (moved.mean, moved.mean)


def test_paired_seeds_take_the_seeds_own_scatter_out():
    """The same models scored otherwise: what seeds differ by is on both sides."""
    new, base = drawn(5, 4, 8, noise=1.0)
    again = base - 0.01
    assert estimate(again, base).p_value > 0.5
    assert estimate(again, base, paired_seeds=True).p_value < 1e-9
    assert new.shape == base.shape


def test_bad_tables_are_refused():
    table = np.zeros((3, 4))
    with pytest.raises(ValueError, match="same images"):
        estimate(table, np.zeros((3, 5)))
    with pytest.raises(ValueError, match="two seeds"):
        estimate(table[:1], table)


def test_the_band_is_a_second_bar_of_what_can_be_seen():
    new, base = drawn(1, 3, 8)
    found = estimate(new, base)
    free, barred = found.detectable(0.05, 0.0), found.detectable(0.05, 10.0)
    assert free > found.critical(0.05) * found.error
    assert barred - 10 == pytest.approx(free - found.critical(0.05) * found.error)
    assert math.isfinite(free)
