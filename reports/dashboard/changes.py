"""Change points of a metric over versions: where neighbours differ by more than chance allows."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.compare import ALPHA, Compared, compare
from splatproof.reports.comparing.corrections import levels
from splatproof.reports.comparing.deciding import Verdict, decide
from splatproof.reports.comparing.sides import Side

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
    mean: float | None = None
    """Difference, of logarithms where `relative`; None: not estimated."""
    low: float | None = None
    high: float | None = None
    """Ends of the interval at the corrected level."""
    relative: bool = False
    """Whether the metric is compared by ratios."""


def changes(versions: Sequence[Sequence[CaseRecord]]) -> dict[str, list[Change]]:
    """What every version is against the one before it, in every metric that `compare` judges.

    With no true change, the chance that any neighbours of a metric are called changed is at most ALPHA.

    Args:
        versions: Finished cases of each version of one row on one scene, from the oldest to the newest.
    Returns: By metric, a change for each version that could be compared with the one before it.
    Source: Holm 1979 over the neighbours; the rule is ours.
    """
    found: dict[str, list[tuple[int, Compared]]] = {}
    for at, (before, after) in enumerate(itertools.pairwise(versions), start=1):
        sides = [
            Side(label=f"version {n}", cases=tuple(own))
            for n, own in ((at, before), (at + 1, after))
        ]
        for one in compare(*sides).compared:
            found.setdefault(one.measure.metric, []).append((at, one))
    return {metric: _corrected(own) for metric, own in found.items()}


def _corrected(neighbours: Sequence[tuple[int, Compared]]) -> list[Change]:
    """Verdicts on one metric's neighbours, corrected for their number."""
    tested = [one.estimate.p_value for _, one in neighbours if one.estimate is not None]
    bounds = iter(levels(tested, "holm", ALPHA))
    told = []
    for at, one in neighbours:
        if one.estimate is None:
            told.append(Change(at=at, verdict=one.verdict, reason=one.reason))
            continue
        level = next(bounds)
        verdict, reason = decide(one.estimate, one.measure, level, ALPHA)
        low, high = one.estimate.interval(level)
        told.append(Change(
            at=at, verdict=verdict, reason=reason, mean=one.estimate.mean, low=low, high=high,
            relative=one.measure.relative,
        ))  # fmt: skip
    return told
