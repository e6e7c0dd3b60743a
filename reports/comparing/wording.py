"""A comparison in words and numbers, the same for terminal, Markdown and pages."""

import math
from collections.abc import Iterator, Sequence

from splatproof.reports.comparing.aggregates import Aggregate
from splatproof.reports.comparing.compare import Compared, Comparison
from splatproof.reports.comparing.corrections import TOLD
from splatproof.reports.comparing.counters import Counted
from splatproof.reports.comparing.deciding import Verdict

ORDER: tuple[Verdict, ...] = ("worse", "better", "undecided", "equal", "not judged")
"""Verdicts as they are listed: what asks for a look first."""
HEADINGS = (
    "verdict", "case", "metric", "BASE", "NEW", "NEW - BASE", "interval", "p", "would show", "seeds",
    "images",
)  # fmt: skip
LEGEND = (
    "NEW - BASE is the mean over images and seeds (times, memory and sizes: the ratio less one) with its "
    "interval at the corrected level; p is corrected; would show: the smallest true difference that "
    "these runs show in 80 of 100 experiments. Equal: the 95 % interval lies inside the noise band."
)
DASH = "–"


def verdict_line(found: Comparison) -> str:
    """What came out, in one line: regressions first.

    Args:
        found: What was compared.
    """
    counts = ", ".join(f"{found.counts[v]} {v}" for v in ORDER if found.counts[v])
    if more := [one.counter for one in found.counters if one.verdict == "worse"]:
        counts += f"; more work: {', '.join(more[:3])}{_more(more, 3)}"
    said = counts or "nothing could be compared"
    if found.not_comparable:
        said += f"; {len(found.not_comparable)} not comparable"
    failing = [one.case for one in found.failures if one.on == "NEW"]
    if failing:
        said = f"newly failing: {', '.join(failing[:3])}{_more(failing, 3)}; {said}"
    if found.regressions:
        return f"REGRESSED: {said}"
    return f"no regression: {said}" if found.judged else f"NOT COMPARED: {said}"


def method_line(found: Comparison) -> str:
    """How false alarms were held down.

    Args:
        found: What was compared.
    """
    tests = f"{found.tests} test" + ("" if found.tests == 1 else "s")
    return f"{tests}; {TOLD[found.correction].format(alpha=found.alpha)}"


def ordered(found: Comparison) -> list[Compared]:
    """All comparisons, by verdict as in ORDER, then as they are.

    Args:
        found: What was compared.
    """
    return sorted(found.compared, key=lambda one: ORDER.index(one.verdict))


def texts(one: Compared) -> list[str]:
    """The cells of a comparison, in the order of HEADINGS.

    Args:
        one: The comparison.
    """
    found, level = one.estimate, one.level
    interval, p, shown = DASH, DASH, DASH
    if found is not None and level is not None and one.detectable is not None:
        low, high = found.interval(level)
        interval = f"[{difference(one, low)}, {difference(one, high)}]"
        p = f"{one.corrected_p:.2g}"
        shown = difference(one, one.detectable).removeprefix("+")
    base, new = one.seeds
    return [
        one.verdict, one.group.name, one.measure.metric, value(one, one.base_mean),
        value(one, one.new_mean), difference(one, mean_difference(one)), interval, p, shown,
        str(base) if base == new else f"{base}, {new}", str(one.images or DASH),
    ]  # fmt: skip


def mean_difference(one: Compared) -> float:
    """NEW - BASE, of logarithms where the metric is compared by ratios; nan where there is none.

    Args:
        one: The comparison.
    """
    if one.estimate is not None:
        return one.estimate.mean
    if one.measure.relative:
        return math.log(one.new_mean / one.base_mean) if one.base_mean > 0 else math.nan
    return one.new_mean - one.base_mean


def value(one: Compared, number: float) -> str:
    """A mean of the metric with its unit.

    Args:
        one: The comparison.
        number: A value in the metric's unit.
    """
    if math.isnan(number):
        return DASH
    unit = f" {one.measure.unit}" if one.measure.unit else ""
    return f"{number:,.{one.measure.digits}f}{unit}"


def difference(one: Compared, number: float) -> str:
    """A difference of the metric with its sign; of ratios in per cent.

    Args:
        one: The comparison.
        number: A difference, of logarithms where the metric is compared by ratios.
    """
    if math.isnan(number):
        return DASH
    if one.measure.relative:
        return f"{100 * math.expm1(number):+.1f} %"
    return f"{number:+.{one.measure.digits + (one.measure.unit == 'dB')}f}"


COUNTERS = ("counter", "case", "name", "BASE", "NEW", "change", "why")


def counter_texts(one: Counted) -> list[str]:
    """The cells of a counter, in the order of COUNTERS.

    Args:
        one: The counter.
    """
    change = f"{100 * (one.new / one.base - 1):+.2f} %" if one.base else DASH
    numbers = [f"{one.base:,}", f"{one.new:,}", change]
    return [one.verdict, one.group.name, one.counter, *numbers, one.reason]


def counters_shown(found: Comparison) -> list[Counted]:
    """Counters that are not the same on both sides, worse ones first.

    Args:
        found: What was compared.
    """
    other = [one for one in found.counters if one.verdict != "same"]
    return sorted(other, key=lambda one: one.verdict != "worse")


def told_apart(items: Sequence[tuple[str, str]]) -> Iterator[tuple[str, list[str]]]:
    """Things by what is said of them, so that one reason is said once.

    Args:
        items: Pairs (thing, what is said of it).
    """
    grouped: dict[str, list[str]] = {}
    for thing, said in items:
        grouped.setdefault(said, []).append(thing)
    yield from grouped.items()


def remarks(found: Comparison) -> list[str]:
    """Everything that is not a comparison and must be said, a line each.

    Args:
        found: What was compared.
    """
    lines = [
        f"{one.case}: {'fails now' if one.on == 'NEW' else 'failed on BASE, finishes now'} ({one.error})"
        for one in found.failures
    ]
    apart = told_apart([(one.what, one.why) for one in found.not_comparable])
    lines += [
        f"not comparable: {', '.join(things[:4])}{_more(things, 4)}: {why}" for why, things in apart
    ]
    for verdict in (one for one in ORDER if one != "equal"):
        without = [
            (f"{o.group.name} {o.measure.metric}", o.reason) for o in found.compared
            if o.verdict == verdict and o.estimate is None
        ]  # fmt: skip
        lines += [
            f"{verdict}: {', '.join(things[:4])}{_more(things, 4)}: {why}"
            for why, things in told_apart(without)
        ]
    lines += [
        f"{why}: {', '.join(names)}" for why, names in told_apart(list(found.not_judged.items()))
    ]
    if same := sum(one.verdict == "same" for one in found.counters):
        lines.append(f"counters that are the same in every seed: {same} of {len(found.counters)}")
    return [*lines, *found.remarks]


def _more(items: Sequence[str], shown: int) -> str:
    return f" and {len(items) - shown} more" if len(items) > shown else ""


def as_effect(one: Compared, number: float) -> float:
    """A difference as people state it: of a metric that is compared by ratios, the ratio less one.

    Args:
        one: The comparison.
        number: A difference, of logarithms where the metric is compared by ratios.
    """
    return math.expm1(number) if one.measure.relative else number


AGGREGATES = (
    "suite", "row", "metric", "mean gain", "interquartile mean of gains", "probability of improvement",
    "scenes", "scores",
)  # fmt: skip


def aggregate_texts(one: Aggregate) -> list[str]:
    """The cells of an aggregate, in the order of AGGREGATES.

    Args:
        one: The aggregate.
    """
    digits = one.measure.digits + (one.measure.unit == "dB")

    def gain(number: float) -> str:
        if one.measure.relative:
            return f"{100 * math.expm1(number):+.1f} %"
        return f"{number:+.{digits}f}"

    middle, chance = one.interquartile, one.improvement
    return [
        f"{one.suite}/{one.protocol}", one.row, one.measure.metric, gain(one.mean),
        f"{gain(middle.value)} [{gain(middle.low)}, {gain(middle.high)}]",
        f"{chance.value:.2f} [{chance.low:.2f}, {chance.high:.2f}]",
        str(one.scenes), str(one.scores),
    ]  # fmt: skip
