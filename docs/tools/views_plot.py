"""What each row gains by more views: means over scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean

from splatproof.reports.measured import Measured
from splatproof.suites.gallery.drawing import COLOURS, panels, save

SHOWN = (("psnr", "PSNR in dB"), ("flip", "FLIP error"))
"""Metrics of the panels, with their titles."""


def draw_views(
    path: Path,
    rows: Sequence[Measured],
    names: Sequence[str],
    protocols: Mapping[int, str],
    scenes: Sequence[str],
) -> None:
    """Write a PNG with a line a row, through the numbers of views from which it was run on every scene.

    Args:
        path: The picture.
        rows: Measured runs; the mean of a scene's seeds counts once.
        names: Rows that are drawn.
        protocols: By number of views, smallest first.
        scenes: Scenes whose mean is drawn.
    """
    figure, axes = panels(len(SHOWN), width=9.0, ratio=0.7)
    for panel, (metric, title) in zip(axes, SHOWN, strict=True):
        for number, name in enumerate(names):
            means = {
                views: fmean(each) for views, protocol in protocols.items()
                if all(each := [_mean(rows, scene, name, protocol, metric) for scene in scenes])
            }  # fmt: skip
            panel.plot(
                list(means), list(means.values()),
                color=COLOURS[number], marker="o", markersize=3, label=name,
            )  # fmt: skip
        panel.set_title(title, fontsize=9)
        panel.set_xlabel("training views", fontsize=8)
        panel.set_xticks(list(protocols))
        panel.tick_params(labelsize=7)
    axes[0].legend(fontsize=7)
    save(figure, path)


def _mean(rows: Sequence[Measured], scene: str, name: str, protocol: str, metric: str) -> float:
    """Mean over seeds; 0 where nothing was measured."""
    found = [
        row.values[metric] for row in rows
        if (row.scene, row.row, row.protocol, row.error) == (scene, name, protocol, "")
    ]  # fmt: skip
    return fmean(found) if found else 0.0
