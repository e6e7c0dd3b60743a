"""Charts of the page of claims: measured effects beside printed ones, and checks beside their bars."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splatproof.base.files import whole_file
from splatproof.reports.findings.finding import Finding
from splatproof.reports.verdicts import Verdict

matplotlib.use("Agg")
COLOURS: Mapping[Verdict, str] = {
    "contradicted": "#cc3311", "no difference": "#ee7733", "direction only": "#ccbb44",
    "undecided": "#aa3377", "holds": "#228833", "too short to judge": "#999999",
    "not testable here": "#dddddd",
}  # fmt: skip
UNJUDGED: Verdict = "too short to judge"
"""Drawn thin: it says nothing yet."""
WIDEST = 3.0
"""Printed effects to both sides of 0 that are shown; intervals are cut there."""
FURTHEST = 1e4
"""Multiples of a bar that are shown at most."""
LINE = 0.32
"""Height of a line in inches."""
LONGEST = 76
"""Letters of a name side by side: longer ones take a second line, or they would leave the chart no room."""


def draw_effects(found: Sequence[Finding], path: Path) -> bool:
    """Each measured effect of a printed one, in printed effects: 0 is none, 1 is what the paper has.

    Args:
        found: Claims with what came of them; those without a printed size or an interval are left out.
        path: PNG to write.
    Returns: Whether there was anything to draw.
    """
    shown = sorted(
        (one for one in found if one.printed and None not in (one.effect, one.low, one.high)),
        key=lambda one: (one.verdict == UNJUDGED, one.paper),
    )
    if not shown:
        return False
    figure, axes = _figure(len(shown))
    for line, one in enumerate(reversed(shown)):
        assert one.printed is not None
        share = [
            max(-WIDEST, min(WIDEST, v / one.printed))
            for v in (one.low, one.effect, one.high) if v is not None
        ]  # fmt: skip
        _interval(axes, line, sorted((share[0], share[2])), share[1], one.verdict)
    axes.axvline(0, color="#222222", linewidth=1)
    axes.axvline(1, color="#222222", linewidth=1, linestyle="--")
    axes.axvspan(0.5, WIDEST, color="#228833", alpha=0.06)
    axes.set_xlim(-WIDEST, WIDEST)
    axes.set_xlabel(
        "measured effect in printed effects: 0 none, 1 as printed;\nholds: right of 0 and into the green"
    )
    _names(axes, [f"{one.paper}: {one.text}" for one in reversed(shown)])
    _legend(axes, shown)
    _save(figure, path)
    return True


def draw_checks(found: Sequence[Finding], path: Path) -> bool:
    """Each check's values as multiples of its bar, towards the claimed side on the right.

    Args:
        found: Claims with what came of them; those without a check, or with bars or values of 0, are left out:
            they are equal or they are not.
        path: PNG to write.
    Returns: Whether there was anything to draw.
    """
    shown = [
        one for one in found
        if one.check and one.bar and one.bar > 0 and None not in (one.effect, one.low, one.high)
        and min(v for v in (one.effect, one.low, one.high) if v is not None) > 0
    ]  # fmt: skip
    if not shown:
        return False
    figure, axes = _figure(len(shown))
    for line, one in enumerate(reversed(shown)):
        assert one.bar is not None
        upward = one.asked.startswith("at least")
        share = [min(FURTHEST, v / one.bar if upward else one.bar / v)
                 for v in (one.low, one.effect, one.high) if v is not None]  # fmt: skip
        _interval(axes, line, sorted((share[0], share[2])), share[1], one.verdict)
    axes.set_xscale("log")
    axes.axvline(1, color="#222222", linewidth=1)
    axes.set_xlabel(f"times better than asked (below 1: missed; cut at {FURTHEST:g})")
    _names(axes, [f"{one.text}: {one.here}" for one in reversed(shown)])
    _legend(axes, shown)
    _save(figure, path)
    return True


def _figure(lines: int) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(12.0, 1.0 + LINE * lines), dpi=90, layout="constrained")
    return figure, figure.subplots()


def _interval(axes: Axes, line: int, ends: list[float], at: float, verdict: Verdict) -> None:
    colour, judged = COLOURS[verdict], verdict != UNJUDGED
    axes.plot(ends, [line, line], color=colour, linewidth=4 if judged else 1.5)
    axes.plot([at], [line], "o", color=colour, markersize=7 if judged else 4)


def _names(axes: Axes, names: list[str]) -> None:
    lines = [fill(name, LONGEST) for name in names]
    axes.set_yticks(range(len(names)), lines, fontsize=8)
    axes.set_ylim(-0.7, len(names) - 0.3)
    axes.grid(axis="x", color="#eeeeee")
    axes.set_axisbelow(True)


def _legend(axes: Axes, found: Sequence[Finding]) -> None:
    for one in {one.verdict: one for one in found}.values():
        colour = COLOURS[one.verdict]
        axes.plot([], [], "o-", color=colour, linewidth=3, label=one.verdict)
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.legend(loc="outside upper center", fontsize=8, ncols=len(COLOURS), frameon=False)


def _save(figure: Figure, path: Path) -> None:
    with whole_file(path) as part:
        figure.savefig(part, format="png")
