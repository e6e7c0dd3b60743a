"""Claims of the store's suites as the page shows them, judged by the store's runs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from splatproof.reports.claims.claim import Claim
from splatproof.reports.dashboard.index import Index
from splatproof.reports.dashboard.numbers import short
from splatproof.reports.dashboard.sides import Side
from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.verdicts import judge


def claims_payload(
    claims: Sequence[Claim], index: Index, sides: Mapping[str, Side]
) -> dict[str, Any]:
    """Every claim of a suite that has runs, with its verdict and links to what it was judged by.

    Args:
        claims: Claims with the suites that have their rows.
        index: The store.
        sides: What can be compared, by id.
    """
    runs: dict[str, list[Summary]] = {}
    for one in index.shown:
        runs.setdefault(one.suite, []).append(one)
    # each claim has its own draws, so that its interval does not depend on what else is judged
    return {"claims": [
        _judged(claim, runs[claim.suite], index, sides) for claim in claims if claim.suite in runs
    ]}  # fmt: skip


def _judged(
    claim: Claim, runs: Sequence[Summary], index: Index, sides: Mapping[str, Side]
) -> dict[str, Any]:
    found = judge(claim, [one.numbers for one in runs], np.random.default_rng(0))
    effects = [None, None, None]
    if found.difference is not None:
        ends = (found.difference.mean, found.difference.low, found.difference.high)
        effects = [short(claim.as_effect(end)) for end in ends]
    return {
        "suite": claim.suite, "paper": claim.paper, "text": claim.text, "row": claim.row,
        "other": claim.other, "metric": claim.metric, "better": claim.better,
        "relative": claim.relative, "printed": short(claim.printed), "bar": short(claim.bar),
        "source": claim.source, "verdict": found.verdict, "reason": found.reason,
        "seeds": found.seeds, "mean": effects[0], "low": effects[1], "high": effects[2],
        "links": _links(claim, runs, index, sides),
    }  # fmt: skip


def _links(
    claim: Claim, runs: Sequence[Summary], index: Index, sides: Mapping[str, Side]
) -> list[dict[str, Any]]:
    """For each table that has both rows: the sides to compare and a run of each for the pictures."""
    row_of = {run.run: run.numbers.row for run in runs}
    found = []
    for brief in (table["brief"] for table in index.tables):
        fits = brief["suite"] == claim.suite and brief["scene"]
        fits = fits and (not claim.protocol or brief["protocol"] == claim.protocol)
        if not fits or (claim.scenes and brief["scene"] not in claim.scenes):
            continue
        own = {row_of[row["runs"][0]]: row for row in brief["rows"] if row["runs"]}
        pair = [own.get(name) for name in (claim.other, claim.row)]
        if all(row is not None for row in pair):
            names = [row["side"] for row in pair if row]
            found.append({
                "scene": brief["scene"], "table": brief["id"],
                "sides": names if all(name in sides for name in names) else None,
                "runs": [row["runs"][0] for row in pair if row],
            })  # fmt: skip
    return found
