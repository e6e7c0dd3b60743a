"""A comparison for the terminal, and for machines."""

from collections.abc import Iterator, Sequence

import rich.table
from rich.console import Group as Lines
from rich.text import Text

from splatproof.reports.comparing import wording
from splatproof.reports.comparing.aggregates import Aggregate
from splatproof.reports.comparing.compare import Compared, Comparison

COLOURS = {"worse": "bold red", "better": "bold green", "equal": "", "undecided": "yellow",
           "not judged": "dim", "changed": "yellow", "not compared": "dim"}  # fmt: skip
LEFT = 3
"""Number of columns that are text."""


def terminal(found: Comparison, aggregates: Sequence[Aggregate]) -> Lines:
    """Everything for a terminal, to be printed by rich.

    Args:
        found: What was compared.
        aggregates: What is said of whole suites beside the means.
    """
    judged = [one for one in wording.ordered(found) if one.verdict != "not judged"]
    line = wording.verdict_line(found)
    parts: list[Text | rich.table.Table] = [
        Text(line, style="bold red" if found.regressions else "bold"),
        Text(f"BASE {found.base}   NEW {found.new}   {wording.method_line(found)}"),
    ]
    if judged:
        parts += [Text(), _table(wording.HEADINGS, map(wording.texts, judged))]
    if aggregates:
        parts += [Text(), _table(wording.AGGREGATES, map(wording.aggregate_texts, aggregates))]
    if counters := wording.counters_shown(found):
        parts += [Text(), _table(wording.COUNTERS, map(wording.counter_texts, counters))]
    if found.differing:
        rows = ([d.kind, d.name, d.base, d.new, d.where] for d in found.differing)
        parts += [Text(), _table(("differed", "name", "BASE", "NEW", "where"), rows, left=5)]
    said = wording.remarks(found)
    parts += [Text(), *(Text(line, style="dim") for line in said)] if said else []
    return Lines(*parts, Text(), Text(wording.LEGEND, style="dim"))


def _table(
    headings: Sequence[str], rows: Iterator[list[str]], left: int = LEFT
) -> rich.table.Table:
    shown = rich.table.Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for number, heading in enumerate(headings):
        shown.add_column(
            heading, justify="left" if number < left else "right", overflow="fold", vertical="top"
        )
    for cells in rows:
        shown.add_row(*(Text(cell, style=COLOURS.get(cell, "")) for cell in cells))
    return shown


def records(found: Comparison, aggregates: Sequence[Aggregate]) -> Iterator[dict[str, object]]:
    """A comparison for machines: objects that say by "kind" what they are, last the summary.

    Args:
        found: What was compared.
        aggregates: What is said of whole suites beside the means.
    """
    for one in found.compared:
        yield {"kind": "comparison", **_record(one, found.alpha)}
    for aggregate in aggregates:
        yield {"kind": "aggregate", **aggregate.record()}
    for failure in found.failures:
        yield {"kind": "failure", "case": failure.case, "on": failure.on, "error": failure.error}
    for fault in found.not_comparable:
        yield {
            "kind": "not comparable",
            "what": fault.what,
            "why": fault.why,
            "lacking": fault.lacking,
        }
    for c in found.counters:
        yield {
            "kind": "counter", "case": c.group.name, "counter": c.counter, "verdict": c.verdict,
            "base": c.base, "new": c.new, "reason": c.reason,
        }  # fmt: skip
    for d in found.differing:
        yield {
            "kind": "differing", "what": d.kind, "name": d.name, "base": d.base, "new": d.new,
            "where": d.where,
        }  # fmt: skip
    yield {
        "kind": "summary", "base": found.base, "new": found.new, "regressed": bool(found.regressions),
        "regressions": found.regressions, "counts": dict(found.counts), "tests": found.tests,
        "alpha": found.alpha, "correction": found.correction, "not_judged": list(found.not_judged),
        "remarks": found.remarks, "line": wording.verdict_line(found),
    }  # fmt: skip


def _record(one: Compared, alpha: float) -> dict[str, object]:
    """A comparison; differences of a relative metric are ratios less one."""
    group, scale = one.group, wording.as_effect
    low, high, inner, outer = None, None, None, None
    if one.estimate is not None and one.level is not None:
        low, high = (scale(one, end) for end in one.estimate.interval(one.level))
        inner, outer = (scale(one, end) for end in one.estimate.interval(alpha))
    return {
        "suite": group.suite, "scene": group.scene, "row": group.row, "protocol": group.protocol,
        "metric": one.measure.metric, "unit": one.measure.unit, "relative": one.measure.relative,
        "higher_is_better": one.measure.higher_is_better, "verdict": one.verdict,
        "reason": one.reason, "base": one.base_mean, "new": one.new_mean,
        "difference": scale(one, wording.mean_difference(one)),
        "interval": [inner, outer], "corrected_interval": [low, high], "p": one.p,
        "corrected_p": one.corrected_p, "level": one.level,
        "detectable": None if one.detectable is None else scale(one, one.detectable),
        "band": None if one.measure.band is None else scale(one, one.measure.band),
        "seeds": list(one.seeds), "images": one.images,
    }  # fmt: skip
