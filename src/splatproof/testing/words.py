"""What a check against a baseline says: the table of what got worse, and where to look."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from splatproof.reference.types.result import picture_name
from splatproof.reports.comparing.compare import Compared, Comparison

VIEWS = 3
"""Worst views that are named for each metric that got worse."""
MISSING = "missing on"
"""How the reason begins where one side alone has a case."""


def faults(found: Comparison, *, strict: bool) -> bool:
    """Whether a check fails: something is worse, fails or cannot be compared, or nothing could be.

    Args:
        found: The verdicts.
        strict: Whether what is undecided, or has no baseline, is a fault too.
    """
    odd = [one for one in found.not_comparable if strict or not one.why.startswith(MISSING)]
    open_ = [one for one in found.compared if strict and one.verdict == "undecided"]
    return bool(found.regressions or odd or open_ or not found.judged)


def told(found: Comparison, folder: Path, asked: Collection[str] = ()) -> str:
    """What is worse, undecided or not compared; empty where there is nothing of these.

    Args:
        found: The verdicts.
        folder: Folder of runs that the suite's folder of this run lies in.
        asked: Metrics that were asked for by name: of these it is said too that they are not judged.
    """
    idle = [one for one in found.compared if one.verdict == "not judged"]
    idle = [one for one in idle if one.measure.metric in asked or not found.judged]
    worse = [one for one in found.compared if one.verdict == "worse"]
    unsure = [one for one in found.compared if one.verdict == "undecided"]
    parts = [_failing(found)]
    if worse:
        head = f"worse than {found.base} ({found.correction} over {found.tests} tests, alpha {found.alpha})"
        parts.append(f"{head}:\n{_table(worse)}")
        parts.append(_reasons([one for one in worse if one.estimate is None]))
        parts += [_views(one, folder) for one in worse]
    if unsure:
        parts.append(f"undecided against {found.base}:\n{_table(unsure)}\n{_reasons(unsure)}")
    if idle:
        parts.append(f"not judged against {found.base}:\n{_reasons(idle)}")
    if found.not_comparable:
        lines = [f"  {one.what}: {one.why}" for one in found.not_comparable]
        parts.append("\n".join([f"not compared with {found.base}:", *lines]))
    if not found.judged:
        parts.append(f"nothing of this run could be compared with {found.base}")
    return "\n".join(part for part in parts if part)


def _reasons(rows: Sequence[Compared]) -> str:
    return "\n".join(f"  {one.group.name} {one.measure.metric}: {one.reason}" for one in rows)


def _failing(found: Comparison) -> str:
    new = [one for one in found.failures if one.on == "NEW"]
    return "\n".join(f"fails now: {one.case}: {one.error}" for one in new)


def _table(rows: Sequence[Compared]) -> str:
    head = ("case", "metric", "before", "now", "change", "interval", "noise band", "detectable")
    lines = [head, *(_cells(one) for one in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def _cells(one: Compared) -> tuple[str, ...]:
    """A comparison as texts; changes of relative metrics in percent."""
    ratio = one.measure.relative

    def size(value: float | None, sign: str = "") -> str:
        if value is None:
            return "-"
        return f"{100 * np.expm1(value):{sign}.2f} %" if ratio else f"{value:{sign}.4g}"

    interval = "-"
    if one.estimate is not None and one.level is not None:
        low, high = one.estimate.interval(one.level)
        interval = f"[{size(low, '+')}, {size(high, '+')}]"
    change = size(one.estimate.mean, "+") if one.estimate is not None else "-"
    means = (f"{one.base_mean:.4f}", f"{one.new_mean:.4f}")
    bounds = (size(one.measure.band), size(one.detectable))
    return (one.group.name, one.measure.metric, *means, change, interval, *bounds)


def _views(one: Compared, folder: Path) -> str:
    """The views that lost most, and their pictures; empty where the metric has no views, or no difference."""
    if one.estimate is None:
        return ""
    name, group = one.measure.metric, one.group
    sides = [[case.measured.images for case in side] for side in (group.base, group.new)]
    views = [v for v in sides[1][0] if all(name in s.get(v, {}) for side in sides for s in side)]
    before, now = (
        {view: float(np.mean([scores[view][name] for scores in side])) for view in views}
        for side in sides
    )
    sign = 1 if one.measure.higher_is_better else -1
    views.sort(key=lambda view: sign * (now[view] - before[view]))
    seed = group.new[0].measured.seed
    row = group.row.rpartition(" -> ")[2]
    case = folder / group.suite / group.scene / row / group.protocol / f"seed{seed}"
    lines = [
        f"  {name} of {view}: {before[view]:.4f} -> {now[view]:.4f}"
        f" {case}/{{truth,renders,errors}}/{picture_name(view)}"
        for view in views[:VIEWS]
    ]
    return "\n".join(["worst views:", *lines]) if lines else ""
