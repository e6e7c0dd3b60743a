"""Rates that are stated, held against simulated suites: false alarms, power, false equality."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from helpers.compared_sides import METRICS, band, drawn_pair, drawn_side
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.sides import Side

SUITES = 30
"""Suites of a simulation that runs in every test run; 1,000 where there is time (slow)."""
CHANCE = 0.001
"""Chance that a simulation whose true rate is the stated one fails its bound."""
WORLDS = {
    "seeds alone": {"noise": 0.05, "interaction": 0.0, "residual": 0.0001},
    "seeds and images": {"noise": 0.05, "interaction": 0.03, "residual": 0.02},
    "images alone": {"noise": 0.001, "interaction": 0.1, "residual": 0.02},
    "many images": {"noise": 0.05, "interaction": 0.1, "residual": 0.02, "images": 30},
}


def most(rate: float, trials: int) -> int:
    """Events that a rate gives more of in CHANCE of all simulations."""
    return int(stats.binom.isf(CHANCE, trials, rate))


def alarms(world: str, suites: int, scenes: int = 2, quiet: float = 1.0) -> tuple[int, int]:
    """Suites with any false better or worse, and with any false equality, of no true difference.

    Args:
        quiet: Noise of NEW's seeds over that of BASE's.
    """
    wrong = equal = 0
    options: dict[str, Any] = {"seeds": 3, "images": 8, "scenes": scenes} | WORLDS[world]
    for seed in range(suites):
        rng = np.random.default_rng(seed)
        hard = rng.normal(24, 3, (scenes, options["images"]))
        base = drawn_side(rng, "base", hard=hard, **options)
        new = drawn_side(rng, "new", hard=hard, **options | {"noise": quiet * options["noise"]})
        verdicts = [one.verdict for one in compare(base, new, bands={}).compared]
        assert len(verdicts) == scenes * len(METRICS)
        wrong += any(verdict in ("better", "worse") for verdict in verdicts)
        equal += any(verdict == "equal" for verdict in verdicts)
    return wrong, equal


@pytest.mark.parametrize("world", ["seeds alone", "seeds and images"])
def test_few_suites_without_a_difference_raise_an_alarm(world: str):
    """Four metrics that hang together, two scenes, three seeds: 5 % of suites at most."""
    wrong, equal = alarms(world, SUITES)
    assert wrong <= most(0.05, SUITES)
    assert equal == 0  # without a band nothing is called equal


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [1.0, 0.3])
@pytest.mark.parametrize("world", WORLDS)
def test_of_1000_suites_without_a_difference_at_most_the_stated_rate_raises_an_alarm(world, quiet):
    wrong, _ = alarms(world, 1000, scenes=5, quiet=quiet)
    assert wrong <= most(0.05, 1000)


def test_the_simulation_sees_a_rate_that_is_too_high():
    """Control: a paired t-test over all scores, which takes no notice of seeds, raises many alarms."""
    loud = 0
    for seed in range(SUITES):
        base, new = drawn_pair(seed, scenes=1, **WORLDS["seeds and images"])
        scores = [
            [s["psnr"] for c in side.cases for s in c.measured.images.values()]
            for side in (base, new)
        ]
        loud += stats.ttest_rel(scores[0], scores[1])[1] < 0.05
    assert loud > most(0.05, SUITES)


def power(effect: float, suites: int) -> tuple[float, float]:
    """Median smallest detectable difference of PSNR, and the share of planted ones that are called."""
    options = {"noise": 0.033, "interaction": 0.049, "residual": 0.033}
    stated, called = [], []
    for seed in range(suites):
        for one in compare(*drawn_pair(seed, -effect, **options), bands={}).compared:
            if one.measure.metric == "psnr":
                stated.append(one.detectable)
                called.append(one.verdict == "worse")
    return float(np.median(stated)), float(np.mean(called))


def test_a_planted_difference_is_seen_as_often_as_is_stated():
    """0.2 dB where 0.2 dB is the smallest detectable: seen in about 80 of 100; twice that always."""
    stated, seen = power(0.2, 50)
    assert stated == pytest.approx(0.2, rel=0.1)
    # 100 draws scatter by 4 %; the stated size is itself estimated, from three seeds
    assert 0.62 <= seen <= 0.92
    assert power(0.4, 10)[1] > 0.95
    assert power(0.05, 10)[1] < 0.2


def test_a_difference_as_large_as_the_band_is_seldom_called_equal():
    """At most alpha / 2 of comparisons; with a wider band, most are."""
    bands = {"psnr": band(0.1)}
    near = far = count = 0
    for seed in range(SUITES):
        pair = drawn_pair(seed, 0.1, seeds=12, interaction=0.002, noise=0.05)
        sides: list[Side] = [*pair]
        for one in compare(*sides, metrics=["psnr"], bands=bands).compared:
            near += one.verdict == "equal"
            count += 1
        same = drawn_pair(seed, 0.0, seeds=12, interaction=0.002, noise=0.05)
        far += compare(*same, metrics=["psnr"], bands=bands).counts["equal"]
    assert near <= most(0.025, count)
    assert far > 0.8 * count
