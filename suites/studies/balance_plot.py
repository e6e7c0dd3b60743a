"""Picture of the balance study: how even the blocks of each partition are, and how well that was foreseen."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from splatproof.reference.partition.block_time import BlockWork, StepCost, block_seconds
from splatproof.suites.gallery.drawing import COLOURS, panels, save

Row = dict[str, Any]


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write balance.png into the folder; nothing where nothing was measured.

    Args:
        rows: Rows of the balance study.
        folder: Folder of the picture.
    """
    found = [row for row in rows if "max_over_mean" in row]
    if not found:
        return []
    partitions = list(dict.fromkeys(row["partition"] for row in found))
    colours = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(partitions)}
    figure, (bars, points) = panels(2, width=12.0, ratio=0.7)
    _bars(bars, found, colours)
    fits = [row for row in rows if "pair" in row]
    if fits:
        _points(
            points,
            found,
            colours,
            StepCost(**{n: fits[-1][n] for n in ("pixel", "gaussian", "pair")}),
        )
    else:
        points.set_axis_off()
    save(figure, folder / "balance.png")
    return [folder / "balance.png"]


def _bars(axes: Axes, found: Sequence[Row], colours: dict[str, str]) -> None:
    """Slowest block over the mean, with intervals, and what was predicted."""
    scenes = list(dict.fromkeys(row["scene"] for row in found))
    width = 0.8 / len(colours)
    for number, (partition, colour) in enumerate(colours.items()):
        own = [row for row in found if row["partition"] == partition]
        at = np.array([scenes.index(row["scene"]) + (number + 0.5) * width - 0.4 for row in own])
        value = np.array([row["max_over_mean"] for row in own])
        ends = np.array([[row["low"], row["high"]] for row in own]).T
        axes.bar(at, value - 1, width * 0.9, bottom=1, color=colour, label=partition)
        axes.errorbar(at, value, np.abs(ends - value), fmt="none", ecolor="k", lw=0.8)
        axes.scatter(at, [row["predicted"] for row in own], marker="_", s=90, color="k", zorder=3)
    axes.set_xticks(range(len(scenes)), scenes)
    axes.set_title("seconds of the slowest block over the mean; dash: predicted", fontsize=9)
    axes.legend(fontsize=7)


def _points(axes: Axes, found: Sequence[Row], colours: dict[str, str], cost: StepCost) -> None:
    """Each block's measured seconds against the model's with fitted coefficients."""
    for partition, colour in colours.items():
        blocks = [one for row in found if row["partition"] == partition for one in row["blocks"]]
        works = [BlockWork(**{n: v for n, v in one.items() if n != "seconds"}) for one in blocks]
        foreseen = [block_seconds(work, cost) for work in works]
        axes.scatter(foreseen, [one["seconds"] for one in blocks], s=14, color=colour)
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], color="k", lw=0.8)
    axes.set_title(
        "a block, one visit of each view: seconds by the fitted model (across), measured",
        fontsize=9,
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
