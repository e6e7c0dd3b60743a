"""Which metrics of two sides are judged, how they are read, and the scores of a group in one of them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from splatproof.base.names import unknown
from splatproof.reports.columns import COSTS, score_column
from splatproof.reports.comparing.bands import Band
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.matching import Group
from splatproof.reports.statistics import Scores

UNASKED = "no noise band and not asked for with --metrics"
"""Why most of what cases have values for is not judged."""


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A metric as it is compared."""

    metric: str
    unit: str
    """Unit of the values; "" where they have none."""
    higher_is_better: bool
    band: float | None
    """Differences within +- this are of no account; None: none is declared, so nothing is called equal
    that is not identical. Of the logarithm where relative."""
    relative: bool
    """Compared by ratios: the logarithms of values are subtracted."""
    digits: int
    """After the point, of values as people read them."""


def measures(
    groups: Sequence[Group], bands: Mapping[str, Band], only: Collection[str] = ()
) -> tuple[list[Measure], dict[str, str]]:
    """The metrics that are judged: those of the protocols and those with a declared band.

    Args:
        groups: Groups that are compared.
        bands: Declared bands by metric.
        only: Names of metrics to judge in their place; empty: as above.
    Returns: Metrics that some case has and that have a better side, in the order of the protocols, then
        of the declared bands (of `only` where given); and by name, sorted, why others are left out: for want
        of a better side or of a band.
    Raises: UsageError for a name in `only` that no case has.
    """
    cases = [case for group in groups for case in (*group.base, *group.new)]
    there = {name for case in cases for name in values_of(case)}
    for name in only:
        if name not in there:
            raise unknown("--metrics", name, there)
    named = {str(m): None for case in cases for m in _listed(case.rules.get("metrics"))}
    wanted = [n for n in dict.fromkeys(only or (*named, *bands)) if n in there]
    found = [m for name in wanted if (m := _measure(name, bands.get(name)))]
    judged = {measure.metric for measure in found}
    left_out = sorted(set(only) - judged) if only else sorted(there - judged)
    return found, {name: _why_not(name, named, only) for name in left_out}


def _why_not(name: str, named: Collection[str], only: Collection[str]) -> str:
    """Why a metric is not judged.

    Args:
        name: Name of a metric that some case has.
        named: Metrics of the protocols: all that is missing of these is their better side.
        only: Metrics that were asked for by name: the same.
    """
    if name in named:
        return (
            "not known here, so that its better side is not: name the file that has it with --plugin, or "
            "install its package"
        )
    return "asked for with --metrics, but has no better side" if name in only else UNASKED


def values_of(case: CaseRecord) -> set[str]:
    """Names of everything that a case has a value for, or a score that is no number.

    Args:
        case: Any case.
    """
    return set(case.measured.values) | {name for own in case.not_finite.values() for name in own}


def _listed(rule: object) -> Sequence[object]:
    return rule if isinstance(rule, (list, tuple)) else ()


def _measure(name: str, band: Band | None) -> Measure | None:
    """How a metric is compared; None for what has no better side."""
    column = {cost.key: cost for cost in COSTS}.get(name) or score_column(name, per_image=True)
    if column.higher_is_better is None:
        return None
    relative = bool(band and band.relative)
    value = None if band is None else math.log1p(band.value) if relative else band.value
    return Measure(
        metric=name, unit=column.unit, higher_is_better=column.higher_is_better, band=value,
        relative=relative, digits=column.digits,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Tables:
    """Scores of a group in one metric: a row a seed, a column an image (one column where runs have one value)."""

    base: Scores
    new: Scores
    images: tuple[str, ...]
    """Names of the columns; "" for the value of a run."""
    infinite: int
    """Images left out because they are infinitely good in every run of both sides."""


@dataclass(frozen=True, kw_only=True)
class Unusable:
    """Why the scores of a group in one metric have no mean difference."""

    why: str
    verdict: Literal["worse", "equal", "undecided"]
    """worse: a score is undefined that was not before; equal: all are infinitely good."""


def tables(group: Group, measure: Measure) -> Tables | Unusable:
    """The scores of a group in a metric, of logarithms where it is compared by ratios.

    An image on which no run has a score (the metric has nothing to look at there) is left out, and so is
    one where all runs of both sides are infinitely good. Where any other score is no finite number, the
    difference of means is none.

    Args:
        group: The group.
        measure: The metric.
    """
    sides = [[_scores(case, measure.metric) for case in side] for side in (group.base, group.new)]
    kept: list[str] = []
    infinite = 0
    for name in sorted({name for side in sides for scores in side for name in scores}):
        values = [[scores.get(name, math.nan) for scores in side] for side in sides]
        flat = [value for side in values for value in side]
        if all(map(math.isfinite, flat)):
            kept.append(name)
        elif all(map(math.isnan, flat)):
            continue
        elif len(set(flat)) == 1:
            infinite += 1
        else:
            return _unusable(measure.metric, name, values)
    if not kept:
        if infinite:
            return Unusable(why="infinite in every image of both sides", verdict="equal")
        return Unusable(why=f"no run has a finite {measure.metric}", verdict="undecided")
    base, new = (
        np.array([[scores[name] for name in kept] for scores in side], dtype=np.float64)
        for side in sides
    )
    if measure.relative:
        if min(base.min(), new.min()) <= 0:
            return Unusable(why="ratios of values that are not positive", verdict="undecided")
        base, new = np.log(base), np.log(new)
    return Tables(base=base, new=new, images=tuple(kept), infinite=infinite)


def same_scores(group: Group, measure: Measure) -> bool:
    """Whether every seed has the very same scores on both sides, infinite and undefined ones included.

    Args:
        group: The group.
        measure: The metric.
    """
    sides = [
        [(case.measured.seed, repr(sorted(_scores(case, measure.metric).items()))) for case in side]
        for side in (group.base, group.new)
    ]
    return sides[0] == sides[1]


def _scores(case: CaseRecord, metric: str) -> dict[str, float]:
    """Scores of a case by image, infinite and undefined ones included; the case's by "" where images have none."""
    finite = {name: own[metric] for name, own in case.measured.images.items() if metric in own}
    odd = {name: float(own[metric]) for name, own in case.not_finite.items() if metric in own}
    images = finite | {name: value for name, value in odd.items() if name}
    if images:
        return images
    whole = case.measured.values.get(metric)
    return odd if whole is None else {"": whole}


def _unusable(metric: str, image: str, values: list[list[float]]) -> Unusable:
    of = f"{metric} of {image}" if image else metric
    for side, own, others in (("NEW", values[1], values[0]), ("BASE", values[0], values[1])):
        for kind, is_odd in (("undefined", math.isnan), ("infinite", math.isinf)):
            if any(map(is_odd, own)):
                lost = kind == "undefined" and side == "NEW" and not any(map(math.isnan, others))
                return Unusable(
                    why=f"{of} is {kind} on {side} and not in all runs",
                    verdict="worse" if lost else "undecided",
                )
    raise AssertionError("only called where a value is not finite")
