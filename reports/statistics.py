"""Seeds and images into means, intervals and verdicts that small samples can bear."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy import special

CONFIDENCE = 0.95
POWER = 0.8
"""Share of experiments in which an effect of the smallest detectable size is seen."""
DRAWS = 4000
"""Bootstrap draws: the ends of a 95 % interval then move by about 2 % of its width."""
BLOCKS = 8
"""The draws are made in so many parts, which bounds the memory for scenes of thousands of images."""
MISSED = 0.1
"""Share of simulated experiments of three seeds in which the 95 % interval misses the truth at most, where images are three to
six and their differences have the skew of an exponential, so that one of them decides. Where these are normal it is 0.05,
and 0.06 of three images."""
SMALL = 16
"""Values that are drawn from at most for which one part is quicker; the draws are the same."""

Scores = Float[np.ndarray, "_ _"]
"""A row a seed, a column an image."""
Sample = Float[np.ndarray, " _"]
Verdict = Literal["higher", "lower", "no difference", "unknown"]


@dataclass(frozen=True)
class Summary:
    """A sample of one value a seed."""

    n: int
    mean: float
    std: float
    """Sample standard deviation (n - 1); nan below two values."""
    low: float
    high: float
    """Ends of the 95 % confidence interval of the mean; nan below two values."""


@dataclass(frozen=True)
class Difference:
    """How much one method's mean exceeds another's on the same images."""

    mean: float
    low: float
    high: float
    """Ends of the 95 % interval; nan where a method has fewer than two seeds."""
    images: int
    """Images that both were scored on; where a scene has one, the interval is over seeds alone."""
    freedom: float
    """Degrees of freedom of the interval; nan where there is none."""

    @property
    def detectable(self) -> float:
        """Smallest true difference that such samples show in POWER of all experiments.

        (t(1 - a/2) + t(POWER)) standard errors, read off the interval; nan where there is none.

        Source: Bloom 1995, "Minimum Detectable Effects".
        """
        error = (self.high - self.low) / 2 / _student(self.freedom)
        return float(error * (_student(self.freedom) + _quantile(POWER, self.freedom)))

    @property
    def verdict(self) -> Verdict:
        """What the interval allows to say; "no difference" when it contains 0."""
        if np.isnan(self.low) or np.isnan(self.high):
            return "unknown"
        if self.low > 0:
            return "higher"
        return "lower" if self.high < 0 else "no difference"


def summarise(values: Sequence[float]) -> Summary:
    """Mean and Student's interval of the mean, m +- t(n - 1) s / sqrt(n).

    Args:
        values: One a seed. An infinite or undefined value leaves the interval undefined.
    Raises: ValueError for an empty sample.
    Source: Student 1908.
    """
    if not values:
        raise ValueError("no values")
    sample, n = np.asarray(values, dtype=np.float64), len(values)
    with np.errstate(invalid="ignore"):  # inf - inf
        mean = float(sample.mean())
        std = float(sample.std(ddof=1)) if n > 1 else np.nan
    half = _student(float(n - 1)) * std / np.sqrt(n) if n > 1 else np.nan
    return Summary(n, mean, std, float(mean - half), float(mean + half))


def paired_difference(
    scenes: Sequence[tuple[Scores, Scores]],
    generator: np.random.Generator,
) -> Difference:
    """Mean of (a - b) over scenes, images and seeds, with a bootstrap interval over images and seeds.

    Images are paired: a draw takes the same images for both methods. Seeds are not: each method's
    are drawn apart. Scenes are fixed: they are the declared set, not a sample. In each scene the
    deviations that a resample of the images, of a's seeds and of b's seeds causes are added up.

    The plain percentile interval is far too narrow for a handful of seeds: resampling n values loses
    the factor sqrt((n - 1) / n) in the spread and Student's t. Both are given back: every deviation
    is scaled by sqrt(n / (n - 1)), and the interval by t / z at Welch and Satterthwaite's degrees of
    freedom. The tests measure its coverage, which few images with one odd among them make worse, see MISSED: a
    handful does not show the tail that the mean of all images depends on.

    Args:
        scenes: One pair of tables a scene, with a row a seed and a column an image, the same images
            in the same order for both.
        generator: Source of the draws.
    Raises: ValueError where the two tables of a scene have other numbers of images.
    Returns: The difference; an undefined interval where a method has one seed in a scene, or where a
        score is not finite.
    Source: Efron and Tibshirani 1993, chapters 12 and 13; Hesterberg 2015 (the narrowness of small
        samples' intervals); Satterthwaite 1946.
    """
    if any(a.shape[1] != b.shape[1] for a, b in scenes):
        raise ValueError("both methods must be scored on the same images")
    images = sum(a.shape[1] for a, _ in scenes)
    with np.errstate(invalid="ignore"):
        mean = float(np.mean([a.mean() - b.mean() for a, b in scenes]))
    few = any(min(len(a), len(b)) < 2 for a, b in scenes)
    if few or not all(np.isfinite(a).all() and np.isfinite(b).all() for a, b in scenes):
        return Difference(mean, np.nan, np.nan, images, np.nan)
    samples = [sample for a, b in scenes for sample in _samples(a, b)]
    deviations = sum(_resampled(sample, generator) for sample in samples) / len(scenes)
    tail = 100 * (1 - CONFIDENCE) / 2
    freedom = _freedom(samples)
    widen = _student(freedom) / special.ndtri(0.5 + CONFIDENCE / 2)
    low, high = np.percentile(deviations, [tail, 100 - tail]) * widen
    return Difference(mean, float(mean + low), float(mean + high), images, freedom)


def _samples(a: Scores, b: Scores) -> list[Sample]:
    """The three samples of a scene whose means add up: paired images, a's seeds, b's seeds."""
    samples = [a.mean(axis=1), -b.mean(axis=1)]
    if a.shape[1] > 1:  # one image says nothing of others
        samples.append(a.mean(axis=0) - b.mean(axis=0))
    return samples


def _resampled(sample: Sample, generator: np.random.Generator) -> Sample:
    """Deviations of resampled means from the sample's mean, scaled to their unbiased spread."""
    n = len(sample)
    blocks = 1 if n <= SMALL else BLOCKS
    shape = (DRAWS // blocks, n)
    drawn = [sample[generator.integers(0, n, shape)].mean(axis=1) for _ in range(blocks)]
    return (np.concatenate(drawn) - sample.mean()) * np.sqrt(n / (n - 1))


def _freedom(samples: Sequence[Sample]) -> float:
    """Degrees of freedom of a sum of means: (sum v)^2 / sum(v^2 / (n - 1)), v = s^2 / n."""
    variances = np.array([sample.var(ddof=1) / len(sample) for sample in samples])
    below = sum(v**2 / (len(s) - 1) for v, s in zip(variances, samples, strict=True))
    return float(variances.sum() ** 2 / below) if below > 0 else np.inf


def _student(freedom: float) -> float:
    """Quantile of Student's t for a two-sided interval."""
    return _quantile(0.5 + CONFIDENCE / 2, freedom)


def _quantile(share: float, freedom: float) -> float:
    """Quantile of Student's t; the function below scipy.stats, whose checks cost more than the bootstrap."""
    return float(special.ndtri(share) if np.isinf(freedom) else special.stdtrit(freedom, share))
