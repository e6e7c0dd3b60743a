"""Picture of the stability study: how each implementation's error grows with the difficulty."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from splatproof.suites.gallery.drawing import COLOURS, save

Row = dict[str, Any]
COLUMNS = 5
PANEL = (3.4, 2.7)
"""Inches of a panel with its title and its axis: fixed, for a layout that is solved takes half a minute."""
KEY = 1.0
"""Inches of the key below."""
LEAST = 1e-9
"""Errors below are drawn there: equal numbers have no place on a logarithmic axis."""


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write stability.png into the folder; nothing where no row is of a ladder.

    Args:
        rows: Rows of the stability study.
        folder: Folder of the picture.
    """
    held = [row for row in rows if "ladder" in row]
    ladders = list(dict.fromkeys((row["component"], row["ladder"]) for row in held))
    if not ladders:
        return []
    names = list(dict.fromkeys(row["implementation"] for row in held))
    colours = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(names)}
    lines = math.ceil(len(ladders) / COLUMNS)
    width, height = PANEL[0] * COLUMNS, PANEL[1] * lines + KEY
    figure = Figure(figsize=(width, height), dpi=100)
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.2 / width, bottom=(KEY + 0.6) / height, top=1 - 0.4 / height,
        wspace=0.25, hspace=0.5,
    )  # fmt: skip
    panels = figure.subplots(lines, COLUMNS, squeeze=False).flatten()
    for panel, ladder in zip(panels, ladders, strict=False):
        own = [row for row in held if (row["component"], row["ladder"]) == ladder]
        _panel(panel, own, colours)
        panel.set_title(ladder[0], fontsize=10)
        panel.set_xlabel(ladder[1])
    for panel in panels[len(ladders) :]:
        panel.set_axis_off()
    key = [Line2D([], [], color=colours[name], marker="o", ms=4, label=name) for name in names]
    key += [Line2D([], [], color="k", label="output, of its largest value"),
            Line2D([], [], color="k", ls="--", label="gradient, relative L2"),
            Line2D([], [], color="k", ls=":", lw=0.8, label="budget of the output")]  # fmt: skip
    figure.legend(handles=key, loc="lower center", ncols=6, fontsize=8)
    save(figure, folder / "stability.png")
    return [folder / "stability.png"]


def _panel(axes: Axes, rows: Sequence[Row], colours: dict[str, str]) -> None:
    for name in dict.fromkeys(row["implementation"] for row in rows):
        own = sorted((r for r in rows if r["implementation"] == name), key=lambda r: r["hardness"])
        at = [row["hardness"] for row in own]
        for key, style in (("max_abs_error", "-"), ("grad_rel_l2", "--")):
            errors = [max(row[key], LEAST) for row in own]
            if key == "grad_rel_l2" and max(errors) == LEAST:  # there is no backward pass
                continue
            axes.plot(at, errors, style, color=colours[name], lw=1.2, marker="o", ms=3)
        axes.plot(at, [row["budget"] for row in own], ":", color=colours[name], lw=0.8)
    axes.set(xscale="log", yscale="log", ylim=(LEAST / 2, 3.0))
    axes.grid(alpha=0.3)
