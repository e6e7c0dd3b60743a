"""Small charts as inline SVG: a page of its own needs no chart library of 4 MB beside its pictures."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

WIDTH, HEIGHT = 440.0, 260.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 14.0, 30.0, 44.0
"""Margins around the plotting area, in the same units as WIDTH and HEIGHT."""
MOST_POINTS = 300
"""Number of points of a line; a longer one is thinned evenly, still finer than the chart's pixels."""


@dataclass(frozen=True)
class Axis:
    """A linear axis: data from `low` to `high` on pixels from `start` to `end`."""

    title: str
    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        """Pixel of a value."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 1)


@dataclass(frozen=True)
class Point:
    """A point of a scatter chart with a vertical interval."""

    label: str
    series: int
    """Number of its colour and shape."""
    x: float
    y: float
    low: float
    high: float
    """Ends of the interval of y; nan: none is known."""


@dataclass(frozen=True)
class Line:
    """A line of a chart over steps."""

    label: str
    series: int
    points: Sequence[tuple[float, float]]


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most `most` + 1 round numbers (1, 2 or 5 times a power of 10) in [low, high].

    Args:
        low: Lower end of the axis, in its own unit.
        high: Upper end of the axis, above `low`.
        most: Number of steps that fit, >= 1.
    """
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next(m for m in (1, 2, 5, 10) if (high - low) / (step * m) <= most)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [i * step for i in range(first, last + 1)]


def scatter(points: Sequence[Point], x_title: str, y_title: str) -> Markup:
    """Points with vertical intervals, x from 0.

    Args:
        points: What is drawn; those that are not finite are left out.
        x_title: Name of the horizontal axis, with its unit.
        y_title: Name of the vertical axis, with its unit.
    Returns: An SVG element; empty where no point is finite.
    """
    shown = [p for p in points if math.isfinite(p.x) and math.isfinite(p.y)]
    if not shown:
        return Markup()
    ends = [v for p in shown for v in (p.y, p.low, p.high) if math.isfinite(v)]
    x, y = _axes((x_title, [0.0, *(p.x for p in shown)]), (y_title, ends))
    marks = []
    for point in shown:
        told = f"{point.label}: {point.x:.4g} {x_title}, {point.y:.4g} {y_title}"
        bar = ""
        if math.isfinite(point.low) and math.isfinite(point.high):
            bar = f'<path class="bar" d="M{x.at(point.x)} {y.at(point.low)}V{y.at(point.high)}"/>'
        shape = _shape(point.series, x.at(point.x), y.at(point.y))
        marks.append(
            f'<g class="c{point.series % 8}"><title>{escape(told)}</title>{bar}{shape}</g>'
        )
    label = f"{y_title} against {x_title}: " + "; ".join(
        f"{p.label} {p.y:.4g} at {p.x:.4g}" for p in shown
    )
    return _svg(label, x, y, marks)


def lines(curves: Sequence[Line], x_title: str, y_title: str) -> Markup:
    """Lines over steps.

    Args:
        curves: What is drawn; values that are not finite are left out.
        x_title: Name of the horizontal axis.
        y_title: Name of the vertical axis.
    Returns: An SVG element; empty where no line has two finite points.
    """
    kept = []
    for curve in curves:
        points = [
            (a, b) for a, b in _thinned(curve.points) if math.isfinite(a) and math.isfinite(b)
        ]
        if len(points) > 1:
            kept.append(Line(curve.label, curve.series, points))
    if not kept:
        return Markup()
    every = [point for curve in kept for point in curve.points]
    x, y = _axes((x_title, [a for a, _ in every]), (y_title, [b for _, b in every]))
    marks = [
        f'<polyline class="c{curve.series % 8}" points="'
        + " ".join(f"{x.at(a)},{y.at(b)}" for a, b in curve.points)
        + f'"><title>{escape(curve.label)}</title></polyline>'
        for curve in kept
    ]
    last = "; ".join(f"{curve.label} ends at {curve.points[-1][1]:.4g}" for curve in kept)
    return _svg(f"{y_title} over {x_title}: {last}", x, y, marks)


def swatch(series: int) -> Markup:
    """The mark of a series for a legend."""
    mark = _shape(series, 7.0, 7.0)
    return Markup(
        f'<svg class="swatch c{series % 8}" viewBox="0 0 14 14" aria-hidden="true">{mark}</svg>'
    )


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    stride = math.ceil(len(points) / MOST_POINTS)
    return [*points[: -1 or None : stride], points[-1]] if points else []


def _axes(x: tuple[str, Iterable[float]], y: tuple[str, Iterable[float]]) -> tuple[Axis, Axis]:
    (x_low, x_high), (y_low, y_high) = _range(x[1]), _range(y[1])
    return (
        Axis(x[0], x_low, x_high, LEFT, WIDTH - RIGHT),
        Axis(y[0], y_low, y_high, HEIGHT - BOTTOM, TOP),
    )


def _range(values: Iterable[float]) -> tuple[float, float]:
    """Least and greatest with 6 % of room, but no room below a least value of 0."""
    low, high = min(kept := list(values)), max(kept)
    room = 0.06 * (high - low) or max(abs(high), 1.0) * 0.05
    return (0.0 if low == 0 else low - room), high + room


def _svg(label: str, x: Axis, y: Axis, marks: Sequence[str]) -> Markup:
    """Frame, grid, tick labels and titles around the marks."""
    base, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    size = f"0 0 {WIDTH} {HEIGHT}"
    parts = [f'<svg class="chart" role="img" viewBox="{size}" aria-label="{escape(label)}">']
    parts.append(f'<text class="title" x="0" y="14">{escape(y.title)}</text>')
    for value in ticks(y.low, y.high):
        at = y.at(value)
        parts.append(f'<path class="grid" d="M{LEFT} {at}H{right}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{at + 4}" text-anchor="end">{value:,.6g}</text>')
    for value in ticks(x.low, x.high):
        at = x.at(value)
        parts.append(f'<text x="{at}" y="{base + 17}" text-anchor="middle">{value:,.6g}</text>')
    parts.append(f'<path class="axis" d="M{LEFT} {base}H{right}"/>')
    parts.append(
        f'<text class="title" x="{right}" y="{HEIGHT - 8}" text-anchor="end">'
        f"{escape(x.title)}</text>"
    )
    parts += [*marks, "</svg>"]
    return Markup("".join(parts))


def _shape(series: int, x: float, y: float) -> str:
    """Circle, square, triangle or diamond, so that colour is not the only difference."""
    paths = (
        f"M{x - 5} {y}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z",
        f"M{x - 4.5} {y - 4.5}h9v9h-9z",
        f"M{x} {y - 5.5}l5.5 9.5h-11z",
        f"M{x} {y - 6}l6 6l-6 6l-6 -6z",
    )
    return f'<path class="mark" d="{paths[series % len(paths)]}"/>'
