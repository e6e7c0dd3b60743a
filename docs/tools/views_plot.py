"""What each row gains by more views: means over the scenes that all of them were run on."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean

from splatproof.reports.measured import Measured
from splatproof.suites.gallery.drawing import COLOURS, panels, save

SHOWN = (("psnr", "PSNR in dB"), ("flip", "FLIP error"))
"""Metrics of the panels, with their titles."""


def draw_views(
    path: Path, rows: Sequence[Measured], names: Sequence[str], protocols: Mapping[int, str]
) -> list[str]:
    """Write a PNG with a line a row.

    Args:
        path: The picture.
        rows: Measured runs.
        names: Rows that are drawn.
        protocols: By number of views, smallest first.
    Returns: The scenes whose mean is shown: those that have every row under every protocol.
    """
    done = [row for row in rows if not row.error]
    had = {(row.scene, row.row, row.protocol) for row in done}
    scenes = [
        scene for scene in dict.fromkeys(row.scene for row in done)
        if all((scene, name, protocol) in had for name in names for protocol in protocols.values())
    ]  # fmt: skip
    figure, axes = panels(len(SHOWN), width=9.0, ratio=0.7)
    for number, name in enumerate(names):
        for panel, (metric, title) in zip(axes, SHOWN, strict=True):
            means = [
                fmean(row.values[metric] for row in done
                      if (row.row, row.protocol) == (name, protocol) and row.scene in scenes)
                for protocol in protocols.values()
            ]  # fmt: skip
            panel.plot(
                list(protocols), means, color=COLOURS[number], marker="o", markersize=3, label=name
            )
            panel.set_title(title, fontsize=9)
            panel.set_xlabel("training views", fontsize=8)
            panel.set_xticks(list(protocols))
            panel.tick_params(labelsize=7)
    axes[0].legend(fontsize=7)
    save(figure, path)
    return scenes
