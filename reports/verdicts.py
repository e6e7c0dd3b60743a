"""What runs allow to say of a paper's claim: a verdict with its interval and its reason.

A claim compares two rows. It is judged by the paired bootstrap over images and seeds; before that a
run has to be one that could have shown the effect: three seeds, density control that did something,
and a score that no longer rises.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from splatproof.reports.claims.claim import Claim
from splatproof.reports.comparable import MIN_SEEDS
from splatproof.reports.measured import Measured
from splatproof.reports.statistics import Difference, Scores, paired_difference

Verdict = Literal[
    "holds", "direction only", "no difference", "contradicted", "undecided", "too short to judge",
    "not testable here",
]  # fmt: skip
"""undecided: of a claim with a bar, whose interval lies on both sides of it."""
HALF = "half"
"""Variant that is its method with half the steps: what the second half of a run still gains."""
SETTLED = 0.3
"""dB of a held-out PSNR that the second half of the steps may gain in a run that is long enough; also dB
of training loss that the last fifth may gain where there is no row of half the steps. A third of the
papers' usual effects, and above what seeds move."""


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A claim and what the runs say of it."""

    claim: Claim
    verdict: Verdict
    difference: Difference | None
    """The difference `row` - `other`, for a ratio that of their logarithms; None: not measured."""
    seeds: int
    """Fewest seeds behind either row."""
    reason: str
    """Why this verdict and no other, in one line."""


def judge(claim: Claim, runs: Sequence[Measured], generator: np.random.Generator) -> Judged:
    """The verdict on a claim.

    In this order: *not testable here* where something is missing or rows are not comparable; *too
    short to judge* below three seeds, where nothing was ever densified, or where a run's score was
    still rising; else by the 95 % interval of the difference. *holds*: it lies on the claimed side of 0
    and reaches half the printed effect; *direction only*: it does not reach that; *contradicted*: it
    lies on the other side; *no difference*: it contains 0. With a bar: *holds* on its better side,
    *contradicted* on its other side, else *undecided*.

    Args:
        claim: What is judged.
        runs: All cases of the suite, failed ones and rows of half the steps included.
        generator: Source of the bootstrap's draws.
    Returns: The verdict; false alarms (an effect in either direction that is none) come in at most
        5 % of claims.
    Source: ours.
    """
    pairs, fault = _pairs(claim, runs)
    if fault:
        return _without(claim, "not testable here", fault)
    every = [run for pair in pairs for side in pair for run in side]
    seeds = min(len(side) for pair in pairs for side in pair)
    if seeds < MIN_SEEDS:
        return _without(
            claim, "too short to judge", f"{_count(seeds)}; {MIN_SEEDS} are needed", seeds
        )
    if still := still_rising(every, claim.metric, runs):
        return _without(claim, "too short to judge", still, seeds)
    tables = [_tables(claim, *pair) for pair in pairs]
    if any(table.size == 0 for pair in tables for table in pair):
        fault = f"no image has {claim.metric} in all runs of both rows"
        return _without(claim, "not testable here", fault, seeds)
    found = paired_difference(tables, generator)
    verdict, reason = _by_bar(claim, found) if claim.bar is not None else _by_effect(claim, found)
    return Judged(claim=claim, verdict=verdict, difference=found, seeds=seeds, reason=reason)


Pair = tuple[list[Measured], list[Measured]]


def _pairs(claim: Claim, runs: Sequence[Measured]) -> tuple[list[Pair], str]:
    """Finished runs of both rows, scene by scene, or why there are none that compare."""
    if claim.missing:
        return [], claim.missing
    own = [run for run in runs if not claim.protocol or run.protocol == claim.protocol]
    sides = {name: [run for run in own if run.row == name] for name in (claim.row, claim.other)}
    for name, side in sides.items():
        if all(run.error for run in side):
            errors = sorted({run.error for run in side})
            return [], f"{name} failed: {errors[0]}" if errors else f"{name} has not been run"
    done = [run for side in sides.values() for run in side if not run.error]
    scenes = claim.scenes or tuple(sorted({run.scene for run in done}))
    if len({run.protocol for run in done}) > 1:
        return [], "the rows were run under several protocols, and the claim names none"
    pairs = []
    for scene in scenes:
        both = tuple(
            [run for run in done if (run.row, run.scene) == (name, scene)] for name in sides
        )
        for name, side in zip(sides, both, strict=True):
            if not side:
                return [], f"{name} has not been run on {scene}"
        if len({run.data for side in both for run in side}) > 1:
            return [], f"the rows were scored on other images of {scene}"
        pairs.append(both)
    return pairs, ""


def still_rising(chosen: Sequence[Measured], metric: str, runs: Sequence[Measured]) -> str:
    """Why runs were too short to show an effect; empty where they were not.

    A run is long enough if something was densified in it and its score has settled: the row of half
    the steps of its method (method@half) is at most SETTLED worse in the held-out metric, or, where
    there is no such row or the metric is no PSNR, the training loss gained at most SETTLED at its end.

    Args:
        chosen: Runs that are to be judged.
        metric: What they are compared in; a PSNR or anything else, for which "psnr" has to be settled.
        runs: All cases of the suite, those of half the steps among them.
    """
    never = sorted({run.row for run in chosen if not run.grown})
    if never:
        return f"{', '.join(never)}: never densified"
    held_out = metric if metric.endswith("psnr") else "psnr"
    late = []
    for row in dict.fromkeys(run.row for run in chosen):
        own = [run for run in chosen if run.row == row]
        gain = half_gain(own[0], held_out, runs)
        if math.isnan(gain):
            gain = float(np.mean([run.late_gain for run in own]))
            if gain > SETTLED:
                late.append(f"{row}: its last fifth still gained {gain:.2f} dB of training loss")
        elif gain > SETTLED:
            late.append(
                f"{row}: the second half of its steps still gained {gain:.2f} dB of {held_out}"
            )
    return "; ".join(late)


def half_gain(run: Measured, metric: str, runs: Sequence[Measured]) -> float:
    """How much better a method is than with half its steps, over the seeds that both have.

    Args:
        run: A run of the method; its scene and protocol count. A variant is taken to need as many steps
            as its method.
        metric: Name of a value of cases.
        runs: All cases of the suite.
    Returns: Mean difference; nan where one of the two rows is not there.
    """
    alike = [r for r in runs if (r.scene, r.protocol) == (run.scene, run.protocol) and not r.error]
    whole, half = (
        {r.seed: r.values[metric] for r in alike if r.row == name and metric in r.values}
        for name in (run.named(), run.named(HALF))
    )
    seeds = whole.keys() & half.keys()
    return float(np.mean([whole[s] - half[s] for s in seeds])) if seeds else math.nan


def _tables(claim: Claim, row: list[Measured], other: list[Measured]) -> tuple[Scores, Scores]:
    """Scores of both rows: a line a seed, a column an image that all have, or one where images have none."""
    every = [*row, *other]
    names = sorted(set.intersection(*(
        {name for name, scores in run.images.items() if claim.metric in scores} for run in every
    )))  # fmt: skip

    def table(runs: list[Measured]) -> Scores:
        if names:
            scores = [[run.images[name][claim.metric] for name in names] for run in runs]
        elif all(claim.metric in run.values for run in every):
            scores = [[run.values[claim.metric]] for run in runs]
        else:
            scores = [[] for _ in runs]
        values = np.array(scores, dtype=np.float64).reshape(len(runs), -1)
        return np.log(values) if claim.relative else values

    return table(row), table(other)


def _by_effect(claim: Claim, found: Difference) -> tuple[Verdict, str]:
    """The verdict of a claimed effect by its interval."""
    sign = 1 if claim.better == "higher" else -1
    low, high = sorted((sign * found.low, sign * found.high))
    if math.isnan(low):
        return "not testable here", f"{claim.metric} is not finite in every run"
    if high < 0:
        return "contradicted", "the interval lies on the other side of 0"
    if low <= 0:
        effect = claim.as_effect(found.detectable)
        size = f"{100 * effect:.0f} %" if claim.relative else f"{effect:.2g}"
        return "no difference", f"the interval contains 0; an effect of {size} would have shown"
    if claim.printed is None:
        return "holds", "the interval lies on the claimed side of 0; no size is printed"
    half = sign * claim.as_difference(claim.printed / 2)
    if high >= half:
        return "holds", "the interval excludes 0 and reaches half the printed effect"
    return "direction only", "the interval excludes 0 and ends below half the printed effect"


def _by_bar(claim: Claim, found: Difference) -> tuple[Verdict, str]:
    """The verdict of a claim with a bar by its interval."""
    assert claim.bar is not None
    sign = 1 if claim.better == "higher" else -1
    low, high = sorted((sign * found.low, sign * found.high))
    bar = sign * claim.as_difference(claim.bar)
    if math.isnan(low):
        return "not testable here", f"{claim.metric} is not finite in every run"
    if low >= bar:
        return "holds", "the whole interval reaches the bar"
    if high < bar:
        return "contradicted", "the whole interval misses the bar"
    return "undecided", "the interval lies on both sides of the bar"


def _without(claim: Claim, verdict: Verdict, reason: str, seeds: int = 0) -> Judged:
    return Judged(claim=claim, verdict=verdict, difference=None, seeds=seeds, reason=reason)


def _count(seeds: int) -> str:
    return f"{seeds} seed{'' if seeds == 1 else 's'}"
