"""Every claim with what came of it, as one kind of row for tables, pages and JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from splatproof.reference.types.checked import Checked
from splatproof.reports.claims.claim import HOUSE, CheckClaim, Claim
from splatproof.reports.claims.obstacles import Known, obstacle
from splatproof.reports.findings.checks import CheckJudged, judge_check
from splatproof.reports.measured import Measured
from splatproof.reports.verdicts import Judged, Verdict, judge, runs_of


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A claim, its verdict and what stands behind it."""

    paper: str
    text: str
    source: str
    """Where it is printed, with the printed values."""
    verdict: Verdict
    reason: str
    """Why this verdict and no other, in one line."""
    suite: str
    """Suite of the rows; empty for a check."""
    check: str
    """Name of the check; empty for rows of a suite."""
    rows: tuple[str, ...]
    metric: str
    """Metric of the rows; of a check what its values are in."""
    protocol: str
    relative: bool
    """Whether effects are ratios row / other - 1."""
    printed: float | None
    bar: float | None
    effect: float | None
    low: float | None
    high: float | None
    """What was found here with its 95 % interval, in the units of `printed`; None: not measured."""
    asked: str
    """The printed effect or the bar, as tables show it."""
    here: str
    """What was found, as tables show it."""
    seeds: int
    """Fewest seeds behind a row; of a check the number of values."""
    runs: tuple[str, ...]
    """Cases behind it: suite/scene/row/protocol/seed<k>."""

    def record(self) -> dict[str, Any]:
        """As one JSON object."""
        return asdict(self)


def findings(
    claims: Sequence[Claim],
    checks: Sequence[CheckClaim],
    runs: Mapping[str, Sequence[Measured]],
    checked: Mapping[str, Checked],
    known: Known,
) -> list[Finding]:
    """What came of each claim, in their order. A claim's interval does not depend on the others.

    Args:
        claims: Claims about rows of suites.
        checks: Claims that checks measure.
        runs: All cases of each suite by its name.
        checked: What was measured by the name of the check.
        known: Methods and suites of this installation.
    """
    found = []
    for claim in claims:
        own = runs.get(claim.suite, ())
        there = {run.row for run in own}
        lacking = "" if set(claim.rows) <= there else obstacle(claim, known)
        judged = judge(
            replace(claim, missing=claim.missing or lacking), own, np.random.default_rng(0)
        )
        found.append(_of_rows(replace(judged, claim=claim), runs_of(claim, own)))
    return [
        *found,
        *(_of_check(judge_check(one, checked.get(one.check)), checked) for one in checks),
    ]


def _of_rows(judged: Judged, runs: Sequence[Measured]) -> Finding:
    claim, difference = judged.claim, judged.difference
    effect = low = high = None
    here = ""
    if difference is not None:
        effect, low, high = (
            _finite(claim.as_effect(value))
            for value in (difference.mean, difference.low, difference.high)
        )
        here = _here(*(None if v is None else claim.shown(v) for v in (effect, low, high)))
    asked = "" if claim.printed is None else claim.shown(claim.printed)
    if claim.bar is not None:
        asked = f"bar {claim.shown(claim.bar)}"
    return Finding(
        paper=claim.paper, text=claim.text, source=claim.source, verdict=judged.verdict,
        reason=judged.reason, suite=claim.suite, check="", rows=tuple(dict.fromkeys(claim.rows)),
        metric=claim.metric, protocol=claim.protocol, relative=claim.relative,
        printed=claim.printed, bar=claim.bar, effect=effect, low=low, high=high, asked=asked,
        here=here, seeds=judged.seeds,
        runs=tuple(f"{claim.suite}/{r.scene}/{r.row}/{r.protocol}/seed{r.seed}" for r in runs),
    )  # fmt: skip


def _of_check(judged: CheckJudged, checked: Mapping[str, Checked]) -> Finding:
    claim = judged.claim
    measured = checked.get(claim.check)
    unit = measured.unit if measured else ""
    at = "at least" if claim.better == "higher" else "at most"
    effect, low, high = map(_finite, (judged.value, judged.low, judged.high))
    shown = [None if value is None else f"{value:.3g}" for value in (effect, low, high)]
    return Finding(
        paper=HOUSE, text=claim.text, source="", verdict=judged.verdict, reason=judged.reason,
        suite="", check=claim.check, rows=(), metric=unit, protocol="", relative=False,
        printed=None, bar=claim.bar, effect=effect, low=low, high=high,
        asked=f"{at} {claim.bar:g}", here=_here(*shown),
        seeds=len(measured.values) if measured else 0, runs=(),
    )  # fmt: skip


def _here(value: str | None, low: str | None, high: str | None) -> str:
    """A value with its interval, as far as there is one."""
    if value is None:
        return ""
    return value if low is None or high is None or low == high else f"{value} [{low}, {high}]"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
