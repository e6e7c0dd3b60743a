"""Better, equal, worse or undecided: the rule that turns an estimate into a verdict."""

from typing import Literal

from splatproof.reports.comparing.estimate import Estimate
from splatproof.reports.comparing.measures import Measure

Verdict = Literal["better", "equal", "worse", "undecided", "not judged"]
"""not judged: of times and memory that do not allow any."""


def decide(found: Estimate, measure: Measure, level: float, alpha: float) -> tuple[Verdict, str]:
    """The verdict on a difference NEW - BASE, and its reason in one line.

    *better*, *worse*: the interval at the corrected level lies on that side of 0, and the mean beyond the
    declared noise band. The first keeps false alarms at the stated rate over all comparisons of a run;
    the second keeps differences from being called that are certain and of no account, as two runs of the
    same code differ by them. *equal*: the interval of confidence 1 - alpha lies inside the band, which is
    two one-sided tests, each at alpha / 2, so a difference as large as the band is called equal in at
    most alpha / 2 of such comparisons. This is not corrected: a correction guards against one alarm too
    many, and an "equal" is none. *undecided*: neither.

    Args:
        found: The difference.
        measure: Its metric: side that is better, and band.
        level: Level of this comparison after correction.
        alpha: Rate before correction.
    Source: Schuirmann 1987 (two one-sided tests); the band as a second bar is ours.
    """
    low, high = found.interval(level)
    band = measure.band or 0.0
    if (low > 0 or high < 0) and abs(found.mean) > band:
        risen = found.mean > 0
        verdict = "better" if risen == measure.higher_is_better else "worse"
        beyond = " and the mean lies beyond the band" if band else ""
        return verdict, f"the corrected interval excludes 0{beyond}"
    inner, outer = found.interval(alpha)
    if measure.band is not None and -band <= inner and outer <= band:
        return "equal", "the interval lies inside the noise band"
    if low > 0 or high < 0:
        return "undecided", "told from 0, but within the noise band"
    if measure.band is None:
        return "undecided", "the corrected interval contains 0, and no noise band is declared"
    if inner > 0 or outer < 0:
        return "undecided", "told from 0 before the correction for all comparisons, not after it"
    return "undecided", "the interval contains 0 and reaches beyond the noise band"
