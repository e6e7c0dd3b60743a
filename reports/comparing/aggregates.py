"""Whole suites beside the means: interquartile mean, probability of improvement, performance profile."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from splatproof.reports.comparing.compare import Compared, Comparison
from splatproof.reports.comparing.measures import Measure, Tables, tables

DRAWS = 1000
"""Bootstrap draws: the ends of a 95 % interval then move by about 4 % of its width."""
CUT = 0.25
"""Share of the scores that is cut off at either end by the interquartile mean."""
THRESHOLDS = 81
"""Points of a performance profile."""
LEAST = 1e-12
"""Half the width of a profile whose scores are all alike."""

Gains = Float[np.ndarray, "_ _"]
"""A row a seed, a column an image."""


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Share of scores (runs x images) that gain at least so much on BASE's mean of the same image."""

    thresholds: Float[np.ndarray, " n"]
    """Gains, in the metric's unit, positive where better."""
    base: Float[np.ndarray, "3 n"]
    """Share of BASE's own scores, and its 95 % interval: what seeds alone scatter."""
    new: Float[np.ndarray, "3 n"]


@dataclass(frozen=True, kw_only=True)
class Aggregate:
    """What a metric says of one row over all scenes of a suite under one protocol.

    Scores are taken relative to BASE's mean of the same image, oriented so that a gain is positive:
    scenes and images differ in difficulty by far more than sides differ, and no score has a natural 0
    and 1 to normalise by.
    """

    suite: str
    protocol: str
    row: str
    measure: Measure
    scenes: int
    scores: int
    """Number of NEW's scores: seeds x images, over scenes."""
    mean: float
    """Mean gain; of logarithms where the metric is compared by ratios, as all gains here."""
    interquartile: Interval
    """Mean of the middle half of NEW's gains: a few views gone wrong do not move it."""
    improvement: Interval
    """Chance that a run of NEW scores better than a run of BASE on the same image; ties count half."""
    profile: Profile

    def record(self) -> dict[str, object]:
        """The aggregate as plain data, without its profile."""
        middle, chance = self.interquartile, self.improvement
        return {
            "suite": self.suite, "protocol": self.protocol, "row": self.row,
            "metric": self.measure.metric, "logarithms": self.measure.relative,
            "scenes": self.scenes, "scores": self.scores, "mean_gain": self.mean,
            "interquartile_mean": [middle.value, middle.low, middle.high],
            "probability_of_improvement": [chance.value, chance.low, chance.high],
        }  # fmt: skip


def aggregate(
    found: Comparison, generator: np.random.Generator, metrics: Sequence[str] = ()
) -> list[Aggregate]:
    """The aggregates of each suite, protocol, row and metric that was tested.

    Intervals are a bootstrap stratified by scene: in each scene the seeds of either side and the images
    (the same for both) are drawn again. With three seeds such intervals are too narrow; they describe,
    and no verdict is taken from them.

    Args:
        found: A comparison.
        generator: Source of the draws.
        metrics: Metrics that are aggregated; empty: the first one of each suite, protocol and row.
    Source: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice";
        relative to BASE's images instead of normalised scores: ours.
    """
    together: dict[tuple[str, str, str], dict[str, list[Compared]]] = defaultdict(dict)
    for one in found.compared:
        if one.estimate is not None and one.images:
            key = one.group.suite, one.group.protocol, one.group.row
            together[key].setdefault(one.measure.metric, []).append(one)
    chosen = []
    for own in together.values():
        chosen += [own[name] for name in (metrics or list(own)[:1]) if name in own]
    return [_aggregate(scenes, generator) for scenes in chosen]


def _aggregate(scenes: Sequence[Compared], generator: np.random.Generator) -> Aggregate:
    measure, group = scenes[0].measure, scenes[0].group
    pairs = [_gains(one) for one in scenes]
    new = np.concatenate([pair[1].ravel() for pair in pairs])
    base = np.concatenate([pair[0].ravel() for pair in pairs])
    every = np.concatenate([new, base, [0.0]])
    margin = max(0.02 * float(np.ptp(every)), LEAST)
    thresholds = np.linspace(every.min() - margin, every.max() + margin, THRESHOLDS)
    middles, chances, bases, news = _drawn(pairs, thresholds, generator)
    return Aggregate(
        suite=group.suite, protocol=group.protocol, row=group.row, measure=measure,
        scenes=len(scenes), scores=new.size,
        mean=float(np.mean([pair[1].mean() for pair in pairs])),
        interquartile=_interval(float(stats.trim_mean(new, CUT)), middles),
        improvement=_interval(_improvement(pairs), chances),
        profile=Profile(
            thresholds=thresholds,
            base=np.vstack([_shares(base, thresholds), np.percentile(bases, [2.5, 97.5], axis=0)]),
            new=np.vstack([_shares(new, thresholds), np.percentile(news, [2.5, 97.5], axis=0)]),
        ),
    )  # fmt: skip


def _gains(one: Compared) -> tuple[Gains, Gains]:
    """Gains of BASE's and NEW's scores on BASE's mean of the same image."""
    found = tables(one.group, one.measure)
    assert isinstance(found, Tables)  # it was tested
    sign = 1.0 if one.measure.higher_is_better else -1.0
    middle = found.base.mean(axis=0)
    return sign * (found.base - middle), sign * (found.new - middle)


def _improvement(pairs: Sequence[tuple[Gains, Gains]]) -> float:
    """Mean over scenes and images of Mann and Whitney's U over its most, n m."""
    return float(np.concatenate([_chances(base, new) for base, new in pairs]).mean())


def _chances(
    base: Float[np.ndarray, "... _ images"], new: Float[np.ndarray, "... _ images"]
) -> Float[np.ndarray, "... images"]:
    """Share of pairs of runs in which NEW is better, of each image; ties count half."""
    one, other = new[..., :, None, :], base[..., None, :, :]
    return (one > other).mean(axis=(-3, -2)) + (one == other).mean(axis=(-3, -2)) / 2


def _shares(
    gains: Float[np.ndarray, " scores"], thresholds: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Share of the gains that reach each threshold."""
    return 1 - np.searchsorted(np.sort(gains), thresholds, side="left") / gains.size


Draws = Float[np.ndarray, " draws"]
Curves = Float[np.ndarray, "draws n"]


def _drawn(
    pairs: Sequence[tuple[Gains, Gains]],
    thresholds: Float[np.ndarray, " n"],
    generator: np.random.Generator,
) -> tuple[Draws, Draws, Curves, Curves]:
    """Interquartile mean, chance of improvement and both profiles of each draw of seeds and images."""
    drawn: list[list[Gains]] = [[], []]
    chances = []
    for pair in pairs:
        images = generator.integers(0, pair[0].shape[1], (DRAWS, 1, pair[0].shape[1]))
        own = [
            side[generator.integers(0, len(side), (DRAWS, len(side), 1)), images] for side in pair
        ]
        chances.append(_chances(own[0], own[1]))
        for kept, scores in zip(drawn, own, strict=True):
            kept.append(scores.reshape(DRAWS, -1))
    base, new = (np.sort(np.concatenate(kept, axis=1), axis=1) for kept in drawn)
    curves = [
        1 - np.array([np.searchsorted(own, thresholds) for own in side]) / side.shape[1]
        for side in (base, new)
    ]
    middles = stats.trim_mean(new, CUT, axis=1)
    return middles, np.concatenate(chances, axis=1).mean(axis=1), curves[0], curves[1]


def _interval(value: float, draws: Draws) -> Interval:
    low, high = np.percentile(draws, [2.5, 97.5])
    return Interval(value=value, low=min(float(low), value), high=max(float(high), value))
