"""Many comparisons at once: which of them count, and at which level each is held."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy import stats

Correction = Literal["holm", "benjamini-hochberg"]
TOLD: dict[Correction, str] = {
    "holm": "Holm's correction: the chance of any false better or worse is at most {alpha:g}",
    "benjamini-hochberg": (
        "Benjamini and Hochberg's correction: of all better and worse, a share of at most {alpha:g} "
        "is false on average"
    ),
}
"""What each promises, with a place for the rate."""


def corrected(p_values: Sequence[float], correction: Correction) -> list[float]:
    """Corrected p-values: those at most alpha are told from 0, at the rate that the correction promises.

    Args:
        p_values: One a comparison, in [0, 1].
        correction: holm bounds the chance of any false alarm, whatever the dependence of the
            comparisons; benjamini-hochberg the expected share of false ones among all alarms, where
            they are independent or depend positively.
    Returns: In the same order, in [0, 1].
    Source: Holm 1979; Benjamini and Hochberg 1995.
    """
    values = np.asarray(p_values, dtype=np.float64)
    if not len(values):
        return []
    if correction == "benjamini-hochberg":
        return stats.false_discovery_control(values, method="bh").tolist()
    order = np.argsort(values, kind="stable")
    steps = values[order] * np.arange(len(values), 0, -1)
    found = np.empty(len(values))
    found[order] = np.minimum(1.0, np.maximum.accumulate(steps))
    return found.tolist()


def levels(p_values: Sequence[float], correction: Correction, alpha: float) -> list[float]:
    """The level of each comparison's interval, such that it excludes 0 where its corrected p is at most alpha.

    Holm: that of the step that decides on it, alpha / (m - k + 1) for the k-th smallest p, from the first
    step that fails on the same for all. Benjamini-Hochberg: alpha r / m for the r that are told from 0
    (their intervals then miss in at most alpha of all such, on average), alpha (r + 1) / m for the others.

    Args:
        p_values: One a comparison.
        correction: As for `corrected`.
        alpha: Rate of false alarms that is allowed.
    Returns: In the same order, in (0, alpha].
    Source: Holm 1979; Benjamini and Yekutieli 2005, "False coverage rate-adjusted multiple confidence
        intervals".
    """
    count = len(p_values)
    told = np.array(corrected(p_values, correction)) <= alpha
    rejected = int(told.sum())
    if correction == "benjamini-hochberg":
        steps = np.where(told, max(rejected, 1), min(rejected + 1, count))
        return (alpha * (steps / max(count, 1))).tolist()
    ranks = np.empty(count, dtype=np.int64)
    ranks[np.argsort(np.asarray(p_values), kind="stable")] = np.arange(count)
    return (alpha / (count - np.minimum(ranks, min(rejected, count - 1)))).tolist()
