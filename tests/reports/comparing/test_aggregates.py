"""Whole suites: against scipy and by hand."""

import numpy as np
import pytest
from scipy import stats

from helpers.compared_sides import drawn_pair
from splatproof.reports.comparing.aggregates import Aggregate, aggregate
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.profile_picture import draw_profile


def whole(seed: int, effect: float, metric: str = "psnr", **options) -> Aggregate:
    found = compare(*drawn_pair(seed, effect, **options), bands={})
    (one,) = aggregate(found, np.random.default_rng(0), [metric])
    return one


def test_the_chance_of_improvement_is_mann_and_whitneys():
    base, new = drawn_pair(3, 0.03, scenes=1)
    one = whole(3, 0.03, scenes=1)
    scores = [
        np.array([[s["psnr"] for s in case.measured.images.values()] for case in side.cases])
        for side in (base, new)
    ]
    found = stats.mannwhitneyu(scores[1], scores[0], axis=0, method="asymptotic").statistic / 9
    assert one.improvement.value == pytest.approx(found.mean())
    assert one.improvement.low <= one.improvement.value <= one.improvement.high


@pytest.mark.parametrize("metric", ["psnr", "flip"])
def test_gains_are_positive_where_better(metric: str):
    better, worse = whole(1, 1.0, metric), whole(1, -1.0, metric)
    assert better.improvement.value == 1
    assert worse.improvement.value == 0
    assert better.interquartile.low > 0 > worse.interquartile.high
    assert better.scores == 2 * 3 * 8


def test_one_view_gone_wrong_moves_the_mean_and_not_the_interquartile_mean():
    base, new = drawn_pair(0, 0.5)
    for case in new.cases:
        case.measured.images["view_3"]["psnr"] -= 20
    found = compare(base, new, bands={})
    (one,) = aggregate(found, np.random.default_rng(0), ["psnr"])
    assert one.mean < -1.5
    assert one.interquartile.value == pytest.approx(0.5, abs=0.15)


def test_a_profile_falls_from_one_and_its_interval_holds_it():
    profile = whole(2, 0.3).profile
    for low, share, high in ((p[1], p[0], p[2]) for p in (profile.base, profile.new)):
        assert share[0] == 1
        assert (np.diff(share) <= 0).all()
        assert (low <= share + 0.02).all()
        assert (share <= high + 0.02).all()
    zero = int(np.abs(profile.thresholds).argmin())
    assert profile.new[0][zero] > 0.9  # nearly all scores of NEW lie above BASE's mean
    assert 0.3 < profile.base[0][zero] < 0.7


def test_the_same_generator_gives_the_same_numbers():
    one, other = whole(2, 0.3), whole(2, 0.3)
    assert one.interquartile == other.interquartile
    assert draw_profile(one) == draw_profile(other)


def test_only_the_first_metric_is_aggregated_unasked():
    found = compare(*drawn_pair(0, 0.2), bands={})
    assert [one.measure.metric for one in aggregate(found, np.random.default_rng(0))] == ["psnr"]
