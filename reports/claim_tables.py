"""The scores by which a claim's rows are compared: a table of seeds and images a row, or why there is none."""

from collections.abc import Sequence

import numpy as np

from splatproof.reports.claims.claim import Claim
from splatproof.reports.measured import Measured
from splatproof.reports.statistics import Scores

Pair = tuple[list[Measured], ...]
"""Finished runs of a claim's rows on one scene."""


def claim_tables(claim: Claim, pair: Pair) -> tuple[Scores, Scores] | str:
    """Scores of both rows: a line a seed, a column an image, or one column where images have no values.

    Where there is no other row its scores are 0; of a ratio they are logarithms.

    Args:
        claim: Says metric and rows.
        pair: Runs of its rows on one scene, which were scored on the same images.
    Returns: The tables, or in one line why nothing is compared: a run that lacks the metric, or its value of an
        image that another run has one of (the mean of the others would leave out what went wrong), and ratios of what is
        not above 0.
    """
    every = [run for side in pair for run in side]
    known = [
        {name for name, scores in run.images.items() if claim.metric in scores} for run in every
    ]
    names = sorted(set.union(*known)) if all(known) else []
    for run, own in zip(every, known, strict=True):
        if names and len(own) < len(names):
            odd = next(name for name in names if name not in own)
            return f"{run.row} seed {run.seed} has no finite {claim.metric} in {odd}, which other runs have"
    if not names and not all(claim.metric in run.values for run in every):
        return f"no image has {claim.metric} in all runs of both rows"
    first = _table(claim, pair[0], names)
    second = _table(claim, pair[1], names) if len(pair) > 1 else np.zeros_like(first)
    if not claim.relative:
        return first, second
    if first.min() <= 0 or second.min() <= 0:
        return f"{claim.metric} is not above 0 in every run, and has no ratio"
    return np.log(first), np.log(second)


def _table(claim: Claim, runs: Sequence[Measured], names: Sequence[str]) -> Scores:
    """Scores of one row; of the case where no image is named."""
    scores = [
        [run.images[name][claim.metric] for name in names] or [run.values[claim.metric]]
        for run in runs
    ]
    return np.array(scores, dtype=np.float64)
