"""Change points of a metric over versions: where neighbours differ by more than chance allows."""

from collections.abc import Sequence
from dataclasses import dataclass

from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.compare import ALPHA
from splatproof.reports.comparing.corrections import levels
from splatproof.reports.comparing.deciding import Verdict, decide
from splatproof.reports.comparing.estimate import Estimate, estimate
from splatproof.reports.comparing.matching import match
from splatproof.reports.comparing.measures import Measure, Unusable, tables
from splatproof.reports.comparing.timing import MACHINE_METRICS, why_not_timed

RULE = (
    "A change point is a version whose paired interval against the version before it, over images and "
    "seeds, excludes 0 after Holm's correction for all neighbours of this metric, by more than the "
    "metric's noise band where one is declared. Times and memory are judged only where runs of both "
    "versions were interleaved on one machine."
)
"""What a change point is, for the page."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a version is against the one before it, in one metric."""

    at: int
    """Place of the version, from 1: the first has none before it."""
    verdict: Verdict
    """better and worse are change points."""
    reason: str
    mean: float | None
    """Difference, of logarithms where the metric is compared by ratios; None: not estimated."""
    low: float | None
    high: float | None
    """Ends of the interval at the corrected level."""


def changes(versions: Sequence[Sequence[CaseRecord]], measure: Measure) -> list[Change]:
    """What every version is against the one before it.

    With no true change, the chance that any neighbours are called changed is at most ALPHA.

    Args:
        versions: Finished cases of each version of one row on one scene, from the oldest to the newest.
        measure: The metric.
    Returns: One change for each version but the first.
    Source: Holm 1979 over the neighbours; the rule is ours.
    """
    found: list[Estimate | tuple[Verdict, str]] = [
        _neighbours(before, after, measure)
        for before, after in zip(versions[:-1], versions[1:], strict=True)
    ]
    tested = [one for one in found if isinstance(one, Estimate)]
    p_values = [one.p_value for one in tested]
    bounds = iter(levels(p_values, "holm", ALPHA))
    told = []
    for at, one in enumerate(found, start=1):
        if not isinstance(one, Estimate):
            verdict, reason = one
            told.append(Change(at=at, verdict=verdict, reason=reason, mean=None, low=None, high=None))
            continue
        level = next(bounds)
        verdict, reason = decide(one, measure, level, ALPHA)
        low, high = one.interval(level)
        told.append(Change(at=at, verdict=verdict, reason=reason, mean=one.mean, low=low, high=high))
    return told


def _neighbours(
    before: Sequence[CaseRecord], after: Sequence[CaseRecord], measure: Measure
) -> Estimate | tuple[Verdict, str]:
    """The difference of two versions, or why there is none."""
    matched = match(before, after)
    if not matched.groups:
        return "undecided", matched.not_comparable[0].why
    group = matched.groups[0]
    if measure.metric in MACHINE_METRICS and (why := why_not_timed(measure.metric, group)):
        return "not judged", why
    scores = tables(group, measure)
    if isinstance(scores, Unusable):
        return scores.verdict, scores.why
    if min(len(scores.base), len(scores.new)) < 2:
        return "undecided", "one seed gives no interval"
    return estimate(scores.new, scores.base)
