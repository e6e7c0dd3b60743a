"""The difference of two groups of runs with what is known of its error, at any level of confidence."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from splatproof.reports.statistics import POWER, Sample, Scores

TINY = 1e-9
"""Share of the largest score below which a difference is rounding: records keep six digits."""

LEAST = 1e-300
"""Smallest p-value that is told apart from 0."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Mean difference of two groups, its variance from seeds and from images, and their freedoms.

    The mean difference is a sum of independent parts: means over seeds of either side, and the mean over
    images of what is particular to each. Their variances add up, and each is known from so few values
    that Student's t is needed: with two to four degrees of freedom for the seeds. Where the two parts
    have other degrees of freedom, the critical value is their quantiles' mean, weighted by variance
    (Cochran's rule). Satterthwaite's single number of degrees of freedom, good at 95 %, is not used:
    at the levels that a correction for 200 comparisons asks for it gave up to five times the stated
    false alarms in simulation (three seeds, 30 images), where Cochran's gave at most twice, and mostly
    fewer than stated. The bootstrap cannot be asked either: 4,000 draws know nothing of a tail of 1/8000.

    Source: Cochran 1964, "Approximate significance levels of the Behrens-Fisher test"; Welch 1947 for the
    freedom of two sides of seeds.
    """

    mean: float
    seed_variance: float
    """Variance of the mean difference because of the seeds, both sides together."""
    seed_freedom: float
    image_variance: float
    """The same because of the images; 0 where there is one value a run."""
    image_freedom: float

    @property
    def error(self) -> float:
        """Standard error of the mean difference."""
        return math.sqrt(self.seed_variance + self.image_variance)

    def critical(self, alpha: float) -> float:
        """Standard errors that a two-sided interval of confidence 1 - alpha reaches to either side.

        Args:
            alpha: Rate of intervals that miss, in (0, 1).
        """
        if self.error == 0:
            return 0.0
        parts = self._parts()
        quantiles = (-weight * special.stdtrit(freedom, alpha / 2) for weight, freedom in parts)
        return float(sum(quantiles) / sum(weight for weight, _ in parts))

    def interval(self, alpha: float) -> tuple[float, float]:
        """Ends of the interval of confidence 1 - alpha.

        Args:
            alpha: Rate of intervals that miss, in (0, 1).
        """
        half = self.critical(alpha) * self.error
        return self.mean - half, self.mean + half

    @property
    def p_value(self) -> float:
        """The smallest alpha whose interval excludes 0; 1 for a difference that is exactly 0."""
        if self.mean == 0:
            return 1.0
        if self.error == 0:
            return 0.0
        t = abs(self.mean) / self.error
        alone = [2 * float(special.stdtr(freedom, -t)) for _, freedom in self._parts()]
        low, high = math.log(max(min(alone), LEAST)), math.log(max(*alone, LEAST))
        parts, total = self._parts(), self.seed_variance + self.image_variance
        # between both parts' own levels their weighted quantile crosses t
        beyond = lambda log: (
            t + sum(w * special.stdtrit(f, math.exp(log) / 2) for w, f in parts) / total
        )
        if not beyond(low) < 0 < beyond(high):
            return math.exp(high if beyond(high) <= 0 else low)
        return math.exp(optimize.root_scalar(beyond, bracket=(low, high), xtol=1e-9).root)

    def detectable(self, alpha: float, band: float) -> float:
        """Smallest true difference that such runs would show in POWER of all experiments.

        Args:
            alpha: Level that the comparison is held to, after correction.
            band: Size that a difference must exceed besides, in the same units.
        Source: Bloom 1995, "Minimum Detectable Effects", with the band as a second bar.
        """
        if self.error == 0:
            return band
        parts = self._parts()
        total = sum(weight for weight, _ in parts)
        more = sum(w * float(special.stdtrit(freedom, POWER)) for w, freedom in parts) / total
        return max(self.critical(alpha) * self.error, band) + more * self.error

    def _parts(self) -> list[tuple[float, float]]:
        """Variance and freedom of each part that has any."""
        both = ((self.seed_variance, self.seed_freedom), (self.image_variance, self.image_freedom))
        return [(variance, freedom) for variance, freedom in both if variance > 0]


def estimate(new: Scores, base: Scores, *, paired_seeds: bool = False) -> Estimate:
    """The mean of new - base over images and seeds.

    Images are paired. Seeds are not: the same seed of two versions draws the same numbers for some steps
    and then no more, and three pairs of seeds have two degrees of freedom where six single ones have up
    to four. Only where both sides hold the very same models (and score them otherwise) are they paired.

    Args:
        new: Finite scores of one side: a row a seed, a column an image, or one column where runs have
            one value.
        base: Those of the other side, the same images in the same order.
        paired_seeds: Whether row k of both is the same model.
    Raises: ValueError for tables of other images, or with fewer than two seeds.
    """
    if new.shape[1] != base.shape[1]:
        raise ValueError("both sides must be scored on the same images")
    if min(len(new), len(base)) < 2:
        raise ValueError("an interval takes two seeds on either side")
    tiny = TINY * max(np.abs(new).max(), np.abs(base).max())
    mean = float(new.mean() - base.mean())
    if paired_seeds:
        samples = [(new - base).mean(axis=1)]
    else:
        samples = [new.mean(axis=1), base.mean(axis=1)]
    seeds, freedom = _combined([_variance_of_mean(sample, tiny) for sample in samples])
    images, images_freedom = 0.0, math.inf
    if new.shape[1] > 1:
        images, images_freedom = _variance_of_mean(new.mean(axis=0) - base.mean(axis=0), tiny)
    return Estimate(
        mean=mean if abs(mean) > tiny else 0.0,
        seed_variance=seeds,
        seed_freedom=freedom,
        image_variance=images,
        image_freedom=images_freedom,
    )


def _variance_of_mean(sample: Sample, tiny: float) -> tuple[float, float]:
    """Variance of a sample's mean, and its degrees of freedom; 0 where all values are one."""
    variance = float(sample.var(ddof=1)) / len(sample)
    return (variance if variance > tiny**2 else 0.0), len(sample) - 1.0


def _combined(parts: list[tuple[float, float]]) -> tuple[float, float]:
    """Variance and degrees of freedom of a sum of independent means: (sum v)^2 / sum(v^2 / f)."""
    total = sum(variance for variance, _ in parts)
    below = sum(variance**2 / freedom for variance, freedom in parts)
    return total, total**2 / below if below > 0 else math.inf
