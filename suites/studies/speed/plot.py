"""Pictures of the speed study: error against time with its frontier, and how cost grows."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splatproof.suites.gallery.drawing import COLOURS, save
from splatproof.suites.studies.speed.page import total_ms

LEAST_ERROR = 1e-16
"""Errors below are drawn here: a logarithmic axis has no zero."""
MARKERS = "osD^vP*X"
Row = dict[str, Any]
Point = tuple[float, float]


class Judged(NamedTuple):
    """One point of the picture."""

    twin: str
    milliseconds: float
    error: float
    exact: bool
    """Whether it approximates nothing: others are hollow and have a star."""


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write pareto.png and growth.png into the folder; one without points is left out.

    Args:
        rows: Rows of the speed study.
        folder: Folder of the pictures.
    """
    made = []
    for name, figure in (("pareto", pareto(rows)), ("growth", growth(rows))):
        if figure is not None:
            save(figure, folder / f"{name}.png")
            made.append(folder / f"{name}.png")
    return made


def frontier(points: Sequence[Point]) -> list[Point]:
    """Points (time, error) that no other one beats or equals in both, fastest first."""
    kept: list[Point] = []
    for time, error in sorted(points):
        if not kept or error < kept[-1][1]:
            kept.append((time, error))
    return kept


def judged(rows: Sequence[Row]) -> dict[str, list[Judged]]:
    """Twins of each component, on the case that their errors are from."""
    found: dict[str, list[Judged]] = {}
    for row in rows:
        time, error = total_ms(row), row.get("max_abs_error")
        if time is None or error is None or row["case"] != row.get("error_case"):
            continue
        if math.isfinite(error):
            place = found.setdefault(row["component"], [])
            exact = not row.get("approximates")
            place.append(Judged(row["twin"], time, max(error, LEAST_ERROR), exact))
    return {component: points for component, points in found.items() if len(points) > 1}


def pareto(rows: Sequence[Row]) -> Figure | None:
    """Error against time, one point a twin and a panel a component."""
    components = judged(rows)
    if not components:
        return None
    columns = min(4, len(components))
    lines = math.ceil(len(components) / columns)
    figure = Figure(figsize=(4 * columns, 4.2 * lines), dpi=100, layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).flatten()
    for panel, (component, points) in zip(panels, components.items(), strict=False):
        _pareto_panel(panel, component, points)
    for panel in panels[len(components) :]:
        panel.set_axis_off()
    return figure


def _pareto_panel(axes: Axes, component: str, points: list[Judged]) -> None:
    best = frontier([(point.milliseconds, point.error) for point in points])
    axes.plot(*zip(*best, strict=True), color="#bbbbbb", drawstyle="steps-post", zorder=0)
    for i, point in enumerate(points):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(
            [point.milliseconds], [point.error], MARKERS[i % len(MARKERS)], color=colour, markersize=7,
            label=point.twin if point.exact else f"{point.twin} *",
            markerfacecolor=colour if point.exact else "none",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", title=component, xlabel="forward + backward, ms",
             ylabel="largest error")  # fmt: skip
    whole_decades(axes)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)


def whole_decades(axes: Axes) -> None:
    """Logarithmic axes from one power of ten to another, with a grid."""
    for low, high, limit in ((*axes.get_xlim(), axes.set_xlim), (*axes.get_ylim(), axes.set_ylim)):
        limit(10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high)))
    axes.minorticks_off()
    axes.grid(alpha=0.3)


def growth(rows: Sequence[Row]) -> Figure | None:
    """Time of the usual rasterizer against Gaussians, and against contributing pairs."""
    shown = [
        row for row in rows
        if row["component"] == "rasterizer" and row.get("usual") and row.get("forward_ms")
    ]  # fmt: skip
    by_size: dict[tuple[int, int], list[Row]] = {}
    for row in shown:
        by_size.setdefault((row["size"][1], row["size"][2]), []).append(row)
    if not shown:
        return None
    figure = Figure(figsize=(10, 4.5), dpi=100, layout="constrained")
    left, right = figure.subplots(1, 2)
    many = {size: each for size, each in by_size.items() if len(each) > 1}
    for colour, (size, each) in zip(COLOURS, many.items(), strict=False):
        each = sorted(each, key=lambda row: row["size"][0])
        counts = [row["size"][0] for row in each]
        for key, style in (("forward_ms", "-o"), ("backward_ms", "--s")):
            kept = [(n, r[key]) for n, r in zip(counts, each, strict=True) if r[key] is not None]
            left.plot(*zip(*kept, strict=True), style, color=colour,
                      label=f"{size[0]}x{size[1]}, {key.removesuffix('_ms')}")  # fmt: skip
    for key, marker, colour in (("forward_ms", "o", COLOURS[0]), ("backward_ms", "s", COLOURS[1])):
        kept = [(row["contributing_pairs"], row[key]) for row in shown if row[key] is not None]
        right.plot(*zip(*sorted(kept), strict=True), marker, color=colour,
                   label=key.removesuffix("_ms"))  # fmt: skip
    for axes, title in ((left, "Gaussians"), (right, "contributing pairs")):
        axes.set(xscale="log", yscale="log", xlabel=title, ylabel="ms")
        whole_decades(axes)
        axes.legend(fontsize=7)
    return figure
