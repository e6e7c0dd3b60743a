"""Intervals against scipy, their coverage by simulation, and what must hold for every sample."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from splatproof.reports.statistics import MISSED, Difference, paired_difference, summarise

finite = st.floats(-1e3, 1e3, allow_nan=False)


def tables(rng: np.random.Generator, shift: float, seeds: int, images: int, scale: float = 1.0):
    """Scores of two methods: hard images are hard for both; the first is better by `shift`."""
    hard = rng.normal(0, 3, images)
    noise = [rng.normal(0, scale, (seeds, 1)) + rng.normal(0, 0.5, (seeds, images)) for _ in "ab"]
    return hard + noise[0] + shift, hard + noise[1]


@settings(deadline=None, max_examples=60)
@given(values=st.lists(finite, min_size=2, max_size=12))
def test_summary_agrees_with_scipy(values: list[float]):
    got = summarise(values)
    assert got.n == len(values)
    assert got.mean == pytest.approx(np.mean(values), abs=1e-9)
    assert got.std == pytest.approx(np.std(values, ddof=1), abs=1e-9)
    if got.std > 1e-9:
        low, high = stats.t.interval(0.95, got.n - 1, np.mean(values), stats.sem(values))
        # both are float64 in another order of operations; the mean may cancel
        assert got.low == pytest.approx(low, rel=1e-9, abs=1e-7)
        assert got.high == pytest.approx(high, rel=1e-9, abs=1e-7)


def test_one_seed_has_a_mean_and_no_interval():
    got = summarise([3.0])
    assert (got.n, got.mean) == (1, 3.0)
    assert all(math.isnan(value) for value in (got.std, got.low, got.high))


@pytest.mark.parametrize("odd", [math.inf, math.nan])
def test_odd_values_leave_the_interval_undefined(odd: float):
    got = summarise([1.0, odd])
    assert repr(got.mean) == repr(odd)
    assert math.isnan(got.std)
    assert math.isnan(got.low)
    a, b = np.array([[1.0], [odd]]), np.array([[1.0], [2.0]])
    assert paired_difference([(a, b)], np.random.default_rng(0)).verdict == "unknown"


def test_an_empty_sample_is_refused():
    with pytest.raises(ValueError, match="no values"):
        summarise([])


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**16),
    seeds=st.integers(2, 5),
    images=st.integers(1, 12),
    shift=st.floats(-5, 5),
)
def test_swapping_the_methods_mirrors_the_interval(seed, seeds, images, shift):
    a, b = tables(np.random.default_rng(seed), shift, seeds, images)
    one = paired_difference([(a, b)], np.random.default_rng(1))
    other = paired_difference([(b, a)], np.random.default_rng(1))
    assert one.mean == pytest.approx(-other.mean)
    assert one.low <= one.mean <= one.high
    assert one.images == images
    # other draws: the ends move by a few per cent of the width
    width = one.high - one.low
    assert one.low == pytest.approx(-other.high, abs=0.15 * width + 1e-12)
    assert one.high == pytest.approx(-other.low, abs=0.15 * width + 1e-12)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**16), moved=st.floats(-50, 50), scale=st.floats(0.1, 10))
def test_what_is_common_to_both_does_not_matter_and_units_scale(seed, moved, scale):
    a, b = tables(np.random.default_rng(seed), 0.3, 3, 6)
    one = paired_difference([(a, b)], np.random.default_rng(seed))
    two = paired_difference(
        [(scale * (a + moved), scale * (b + moved))], np.random.default_rng(seed)
    )
    wanted = (scale * one.mean, scale * one.low, scale * one.high)
    assert (two.mean, two.low, two.high) == pytest.approx(
        wanted, abs=1e-9 * (1 + abs(moved)) * scale
    )


def test_the_order_of_images_does_not_matter_but_the_pairing_does():
    a, b = tables(np.random.default_rng(3), 1.0, 3, 10, scale=0.05)
    turn = np.random.default_rng(4).permutation(10)
    paired = paired_difference([(a, b)], np.random.default_rng(0))
    turned = paired_difference([(a[:, turn], b[:, turn])], np.random.default_rng(0))
    broken = paired_difference([(a, b[:, turn])], np.random.default_rng(0))
    assert paired.mean == pytest.approx(turned.mean)
    assert paired.high - paired.low == pytest.approx(turned.high - turned.low, rel=0.1)
    assert broken.high - broken.low > 3 * (paired.high - paired.low)
    assert (paired.verdict, broken.verdict) == ("higher", "no difference")


def test_one_seed_knows_no_difference_and_one_image_counts_seeds_alone():
    a, b = np.array([[1.0, 2.0]]), np.array([[0.0, 1.0], [0.1, 1.1]])
    assert paired_difference([(a, b)], np.random.default_rng(0)).verdict == "unknown"
    a, b = np.array([[5.0], [5.1], [4.9]]), np.array([[1.0], [1.1], [0.9]])
    got = paired_difference([(a, b)], np.random.default_rng(0))
    assert got.images == 1
    assert got.verdict == "higher"


def test_a_method_against_itself_is_no_difference():
    a = np.full((3, 4), 20.0)
    assert paired_difference([(a, a)], np.random.default_rng(0)) == Difference(
        0.0, 0.0, 0.0, 4, math.inf
    )


def test_other_images_are_refused():
    with pytest.raises(ValueError, match="same images"):
        paired_difference([(np.zeros((2, 3)), np.zeros((2, 4)))], np.random.default_rng(0))


def test_scenes_are_averaged_not_pooled():
    many, few = np.zeros((2, 30)), np.zeros((2, 2))
    got = paired_difference([(many + 1, many), (few + 5, few)], np.random.default_rng(0))
    assert got.mean == 3
    assert got.images == 32


def misses(half_width_factor: float, seeds: int, images: int, repeats: int = 400) -> float:
    """Share of repeated experiments whose interval does not hold the true difference of 0."""
    rng, out = np.random.default_rng(12), 0
    for _ in range(repeats):
        got = paired_difference([tables(rng, 0.0, seeds, images)], rng)
        low = got.mean - half_width_factor * (got.mean - got.low)
        high = got.mean + half_width_factor * (got.high - got.mean)
        out += not low <= 0 <= high
    return out / repeats


# 5 % of 400 repeats is 20 with a standard deviation of 4.4: at most 8.3 % three deviations up
CAP = 0.05 + 3 * math.sqrt(0.05 * 0.95 / 400)


@pytest.mark.parametrize(("seeds", "images"), [(3, 1), (3, 8), (5, 20)])
def test_equal_methods_are_told_apart_at_most_as_often_as_claimed(seeds: int, images: int):
    assert misses(1.0, seeds, images) <= CAP


@pytest.mark.parametrize("images", [3, 6])
def test_few_images_of_which_one_decides_are_missed_as_often_as_the_pages_say(images: int):
    rng, out, repeats = np.random.default_rng(12), 0, 800
    for _ in range(repeats):
        a, b = tables(rng, 0.0, 3, images, scale=0.1)
        got = paired_difference([(a + rng.exponential(2, images) - 2, b)], rng)
        out += not got.low <= 0 <= got.high
    assert 0.05 < out / repeats <= MISSED + 3 * math.sqrt(MISSED * (1 - MISSED) / repeats)


def test_the_coverage_check_rejects_the_plain_percentile_interval():
    # without sqrt(n / (n - 1)) and t / z: at three seeds each the width is less than half
    plain = math.sqrt(2 / 3) * float(stats.norm.ppf(0.975) / stats.t.ppf(0.975, 4))
    assert misses(plain, 3, 8) > CAP


@pytest.mark.parametrize(("low", "high", "verdict"), [
    (0.1, 0.3, "higher"), (-0.3, -0.1, "lower"), (-0.1, 0.1, "no difference"),
    (0.0, 0.2, "no difference"), (math.nan, math.nan, "unknown"),
])  # fmt: skip
def test_verdicts(low: float, high: float, verdict: str):
    assert Difference(0.0, low, high, 3, 4.0).verdict == verdict
