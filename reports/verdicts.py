"""What runs allow to say of a paper's claim: a verdict with its interval and its reason.

A claim compares two rows. It is judged by the paired bootstrap over images and seeds; before that a
run has to be one that could have shown the effect: three seeds, density control that did something,
and a score that no longer rises.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from splatproof.reports.claim_tables import Pair, claim_tables
from splatproof.reports.claims.claim import Claim
from splatproof.reports.comparable import MIN_SEEDS
from splatproof.reports.measured import OF_ALL_PROCESSES, Measured
from splatproof.reports.statistics import Difference, paired_difference

Verdict = Literal[
    "holds", "direction only", "no difference", "contradicted", "undecided", "too short to judge",
    "not testable here",
]  # fmt: skip
"""undecided: of a claim with a bar, whose interval lies on both sides of it."""
HALF, DOUBLE = "half", "double"
"""Variants that are their method with half and with twice the steps, and how the names of those of a variant end: what
further steps would still give."""
SETTLED = 0.3
"""dB that further steps may give whatever the difference: a third of the papers' usual effects, and above
what seeds move."""
SETTLED_SHARE = 0.1
"""The same of values that are no dB, as a share of the value."""

FRAME = "render_ms"
TIMES = (
    "train_seconds", "four_machine_seconds", FRAME, "seconds_max_over_mean",
    "seconds_std_over_mean",
)  # fmt: skip
"""Metrics that other work on the machine changes."""
TOTALS = ("train_seconds", "four_machine_seconds", "four_machine_cpu_seconds", "cpu_seconds")
"""Metrics that are sums over a run's steps: with half of them there is half of it, and nothing has changed."""
WAITED = 1.2
"""Wall seconds of training a CPU second of the whole case from which a run waited for others: alone, on
one thread, it has no more than 1."""
VISITS = "least_visits"
"""Counter of how often training visited the photo that it visited least."""
UNCOUNTED = "recorded before the processes of blocks were counted"


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

    In this order: *not testable here* where something is missing, rows are not comparable, or a time is
    claimed and the machine had other work or may have had it; *too
    short to judge* below three seeds, where nothing was ever densified, where a photo is known to have been visited fewer
    times than the claim asks for, or where a row still changed by
    more than it differs from the other, or from the other and the bar, see `still_changing`; else by the 95 % interval of the
    difference. *holds*: it lies on the claimed side of 0 and reaches half the printed effect; *direction
    only*: it does not reach that; *contradicted*: it lies on the other side; *no difference*: it
    contains 0. With a bar: *holds* on its better side, *contradicted* on its other side, else
    *undecided*.

    Of a claim without another row it is the row's own value that is held against the bar.

    Args:
        claim: What is judged.
        runs: All cases of the suite, failed ones and rows of half the steps included.
        generator: Source of the bootstrap's draws.
    Returns: The verdict; false alarms (an effect in either direction that is none) come in 5 % of claims, of three to six
        images in at most `statistics.MISSED`.
    Source: ours.
    """
    pairs, fault = _pairs(claim, runs)
    if fault:
        return _without(claim, "not testable here", fault)
    every = [run for pair in pairs for side in pair for run in side]
    seeds = min(len(side) for pair in pairs for side in pair)
    if fault := untimed_among(claim.metric, every):
        return _without(claim, "not testable here", fault, seeds)
    if short := _short(claim, every, seeds):
        return _without(claim, "too short to judge", short, seeds)
    tables = [claim_tables(claim, pair) for pair in pairs]
    if faults := [one for one in tables if isinstance(one, str)]:
        return _without(claim, "not testable here", faults[0], seeds)
    found = paired_difference([one for one in tables if not isinstance(one, str)], generator)
    beyond = found.mean - (0 if claim.bar is None else claim.as_difference(claim.bar))
    verdict, reason = _by_bar(claim, found) if claim.bar is not None else _by_effect(claim, found)
    settled = claim.before_training or claim.fixed_length
    decided = claim.bar is not None and verdict != "undecided"
    if not settled and (still := still_changing(claim, every, beyond, runs, decided)):
        return replace(_without(claim, "too short to judge", still, seeds), difference=found)
    return Judged(claim=claim, verdict=verdict, difference=found, seeds=seeds, reason=reason)


def untimed_among(metric: str, every: Sequence[Measured]) -> str:
    """Why costs of runs are not compared, with the rows that each reason is about; empty where they are.

    Args:
        metric: Name of a value of cases.
        every: Finished runs that are compared with one another.
    """
    if metric == FRAME and len(sessions := {run.turns for run in every}) == 1 and all(sessions):
        return ""  # drawn in turns with one another
    rows: dict[str, set[str]] = {}
    for run in every:
        if why := untimed(metric, run):
            rows.setdefault(why, set()).add(run.row)
    return "; ".join(f"{', '.join(sorted(own))}: {why}" for why, own in sorted(rows.items()))


def _short(claim: Claim, every: Sequence[Measured], seeds: int) -> str:
    """Why runs are too few, or none that could have shown the effect; empty where they are neither."""
    few = [] if seeds >= MIN_SEEDS else [f"{_count(seeds)}; {MIN_SEEDS} are needed"]
    never = sorted({run.row for run in every if run.grown == 0})
    if never and not claim.before_training:
        few.append(f"{', '.join(never)}: never densified")
    if not (claim.before_training or claim.fixed_length):
        few += _seldom(claim, every)
    return "; ".join(few)


def _seldom(claim: Claim, every: Sequence[Measured]) -> list[str]:
    """Rows that are known to have visited one of their photos fewer times than the claim asks for."""
    least: dict[str, int] = {}
    for run in every:
        if (visits := run.counters.get(VISITS)) is not None:
            least[run.row] = min(visits, least.get(run.row, visits))
    return [
        f"{row}: a photo was visited {visits} times; {claim.visits} are needed"
        for row, visits in sorted(least.items())
        if visits < claim.visits
    ]


def waited(run: Measured) -> bool:
    """Whether a run's training took longer than its work, so that its times are of the machine's load.

    Args:
        run: A finished run whose processes were all counted, see `Measured.blocks_uncounted`.
    """
    wall, cpu = (run.values.get(name, 0.0) for name in ("train_seconds", "cpu_seconds"))
    return wall > WAITED * cpu


def untimed(metric: str, run: Measured) -> str:
    """Why what a run says of a cost is not its own; empty where it is, or where the metric is no such cost.

    Args:
        metric: Name of a value of cases.
        run: A finished run.
    """
    if metric in OF_ALL_PROCESSES and run.blocks_uncounted:
        return UNCOUNTED
    if metric not in TIMES:
        return ""
    if run.blocks_uncounted:
        return f"{UNCOUNTED}: whether the machine had other work is not known"
    if metric == FRAME and run.turns:
        return "its frames had turns with other rows, not with what it is compared with"
    return "timed while the machine had other work" if waited(run) else ""


def runs_of(claim: Claim, runs: Sequence[Measured]) -> list[Measured]:
    """The runs that a claim is about, failed ones included, in their order.

    Args:
        claim: Says rows, scenes and protocol.
        runs: All cases of the suite.
    """
    return [
        run for run in runs
        if run.row in claim.rows
        and (not claim.protocol or run.protocol == claim.protocol)
        and (not claim.scenes or run.scene in claim.scenes)
    ]  # fmt: skip


def _pairs(claim: Claim, runs: Sequence[Measured]) -> tuple[list[Pair], str]:
    """Finished runs of both rows, scene by scene, or why there are none that compare."""
    if claim.missing:
        return [], claim.missing
    own = runs_of(claim, runs)
    sides = {name: [run for run in own if run.row == name] for name in claim.rows}
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


def still_changing(
    claim: Claim,
    chosen: Sequence[Measured],
    difference: float,
    runs: Sequence[Measured],
    decided: bool = False,
) -> str:
    """Why runs were too short to bear a difference; empty where they were not.

    What all further steps could change is known from a row of half or of twice the steps, see `further_gain`.
    A run is long enough if that is at most SETTLED or SETTLED_SHARE, or at most the difference itself (with a bar: what
    parts it from that), which then keeps its sign. A PSNR that falls has settled. Of several scenes it is the mean that counts,
    as it is of the difference. Where there is no such row, what the last fifth of the run gained in training
    loss stands in for a gain in PSNR.

    Args:
        claim: What is judged.
        chosen: Runs of its rows.
        difference: What they differ by, as it is compared, less the bar if there is one.
        runs: All cases of the suite, those of half and twice the steps among them.
        decided: The whole interval lies on one side of a bar, so that a row which leads further away from it is no matter.
    """
    decibels = "psnr" in claim.metric.split("_")
    late = []
    for row in dict.fromkeys(run.row for run in chosen):
        own = [run for run in chosen if run.row == row]
        change = _mean_further_gain(own, claim.metric, runs)
        value = float(np.mean([abs(run.values.get(claim.metric, math.nan)) for run in own]))
        told = f"further steps would change {claim.metric} by about {change:+.2g}"
        bound = max(abs(difference), SETTLED if decibels else SETTLED_SHARE * value)
        if math.isnan(change):
            change = float(np.mean([run.late_gain for run in own]))
            told = f"its last fifth still gained {change:.2f} dB of training loss"
            bound = max(abs(difference), SETTLED) if decibels else SETTLED
        else:
            if decided and (change if row == claim.row else -change) * difference > 0:
                continue
            if claim.relative:
                change, bound = change / value, max(math.expm1(abs(difference)), SETTLED_SHARE)
        if (change if decibels else abs(change)) > bound:
            late.append(f"{row}: {told}")
    return "; ".join(late)


def _mean_further_gain(own: Sequence[Measured], metric: str, runs: Sequence[Measured]) -> float:
    """`further_gain` of a row, mean of the scenes that have a row of other length; nan where none has."""
    scenes = {run.scene: run for run in own}.values()
    gains = [gain for run in scenes if not math.isnan(gain := further_gain(run, metric, runs))]
    return float(np.mean(gains)) if gains else math.nan


def further_gain(run: Measured, metric: str, runs: Sequence[Measured]) -> float:
    """What all steps beyond a method's own would give, if each doubling gives half as much as the one before.

    That is as much as the second half of its steps gave (against the row method@half), and twice what
    twice the steps give (method@double): the latter is measured where the former is foretold, and counts
    where both are there. Of a row of twice the steps the second half is what it gained on its method, and twice its steps
    are those of method@double-double.

    Args:
        run: A run of the method; its scene and protocol count. A variant is taken to need as many steps
            as the variant that its name begins with and that has rows of both lengths (`m@a-b` as
            `m@a`, if there is `m@a-double` or `m@a-half`), else as its method, and a row whose own depth
            prior has no row of other length as many as with another.
        metric: Name of a value of cases.
        runs: All cases of the suite.
    Returns: Mean over the seeds that both rows have, of sums over steps without what the steps
        themselves add; nan where there are no two such rows. Of times a frame both have to be of one session of turns, or of
        none.
    Source: ours.
    """
    alike = [r for r in runs if (r.scene, r.protocol) == (run.scene, run.protocol) and not r.error]
    own = _variant(run)
    is_double = other_length(own)[1] == DOUBLE
    for stem in _stems(run):
        if doubled := _doubling_gains(run, metric, alike, stem, DOUBLE):
            return (1 if is_double and stem != own else 2) * float(np.mean(doubled))
        if not is_double and (second := _doubling_gains(run, metric, alike, stem, HALF)):
            return float(np.mean(second))
    return math.nan


def _doubling_gains(
    run: Measured, metric: str, alike: Sequence[Measured], stem: str, length: str
) -> list[float]:
    """What the longer of two rows has more than the shorter one, by seed: a variant, and the same of other length."""
    named = f"{stem}-{length}" if stem else length
    others = [r for r in alike if r.row == r.named(named) and r.named() == run.named(axes=_axes(r))]
    others = [r for r in others if _axes(r) == _axes(run)] or others
    before = 2 if metric in TOTALS else 1
    pairs = [
        (whole, other) if length == DOUBLE else (other, whole)
        for other in others
        for whole in alike
        if (whole.row, whole.seed) == (other.named(stem), other.seed)
        and (metric != FRAME or whole.turns == other.turns)
        and metric in whole.values and metric in other.values
    ]  # fmt: skip
    return [longer.values[metric] - before * short.values[metric] for short, longer in pairs]


def other_length(variant: str) -> tuple[str, str]:
    """The variant that one of other length is of, and HALF or DOUBLE: ("ours", "double") of "ours-double".

    Args:
        variant: Name of a variant; of one that has its method's length it is itself, and "".
    """
    stem, _, last = variant.rpartition("-")
    return (stem, last) if last in (HALF, DOUBLE) else (variant, "")


def _stems(run: Measured) -> list[str]:
    """Variants that a row's may be one of, the nearest first: a-b, a, and none."""
    parts = _variant(run).split("-")
    return ["-".join(parts[:count]) for count in range(len(parts), -1, -1)]


def _variant(run: Measured) -> str:
    """The variant of a row's method, empty where it has none."""
    return run.row.partition("~")[0].partition("@")[2]


def _axes(run: Measured) -> str:
    """What stands behind a row's method and variant: noise and prior."""
    _, tilde, axes = run.row.partition("~")
    return tilde + axes


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
