"""Verdicts on what this project claims of itself, from what checks measured."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from splatproof.reference.types.checked import Checked
from splatproof.reports.claims.claim import CheckClaim
from splatproof.reports.statistics import CONFIDENCE
from splatproof.reports.verdicts import Verdict

LEAST = 6
"""Repetitions below which no two of them enclose the median with 95 %: 1 - 2 / 2^n."""


@dataclass(frozen=True, kw_only=True)
class CheckJudged:
    """A claim and what its check says of it."""

    claim: CheckClaim
    verdict: Verdict
    value: float
    """Median of the measured values, or the one furthest from the claimed side; nan: none."""
    low: float
    high: float
    """Interval of the median, or least and largest value; nan: none."""
    reason: str


def judge_check(claim: CheckClaim, found: Checked | None) -> CheckJudged:
    """The verdict on a claim that a check measures.

    *not testable here* where something is missing, the check has not run or could not. Of counts and
    errors (`by` every) it *holds* if every value reaches the bar, else it is *contradicted*. Of times
    it takes at least LEAST repetitions, else it is *too short to judge*; it *holds* if the whole 95 %
    interval of the median reaches the bar, is *contradicted* if the whole interval misses it, and
    *undecided* if the interval lies on both sides.

    Args:
        claim: What is judged.
        found: What the check measured; None: nothing yet.
    Source: ours; the interval between order statistics is Conover 1999, section 3.2.
    """
    missing = claim.missing or ("has not been run" if found is None else found.error)
    if missing or found is None:
        reason = missing if claim.missing else f"check {claim.check}: {missing}"
        return _judged(claim, "not testable here", reason)
    values = np.array(found.values)
    if not values.size or not np.isfinite(values).all():
        reason = f"check {claim.check}: measured {[*found.values] or 'nothing'}"
        return _judged(claim, "not testable here", reason)
    sign = 1 if claim.better == "higher" else -1
    if claim.by == "every":
        reached = sign * values >= sign * claim.bar
        worst = float(sign * (sign * values).min())
        reason = (
            f"{reached.sum()} of {_count(values.size, 'value')} reach the bar; {found.compared}"
        )
        ends = float(values.min()), float(values.max())
        return _judged(claim, "holds" if reached.all() else "contradicted", reason, worst, *ends)
    middle = float(np.median(values))
    if values.size < LEAST:
        reason = f"{_count(values.size, 'repetition')}; {LEAST} are needed; {found.compared}"
        return _judged(claim, "too short to judge", reason, middle)
    interval = stats.quantile_test(values, p=0.5).confidence_interval(CONFIDENCE)
    low, high = float(interval.low), float(interval.high)
    near, far = sorted((sign * low, sign * high))
    verdict: Verdict = "undecided"
    if near >= sign * claim.bar:
        verdict = "holds"
    elif far < sign * claim.bar:
        verdict = "contradicted"
    reason = f"interval of the median of {values.size} repetitions; {found.compared}"
    return _judged(claim, verdict, reason, middle, low, high)


def _judged(
    claim: CheckClaim, verdict: Verdict, reason: str, value: float = math.nan,
    low: float = math.nan, high: float = math.nan,
) -> CheckJudged:  # fmt: skip
    return CheckJudged(claim=claim, verdict=verdict, value=value, low=low, high=high, reason=reason)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
