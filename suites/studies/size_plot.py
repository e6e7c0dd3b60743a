"""Picture of the size study: curves of bytes against the loss of PSNR, scene by scene."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatproof.suites.gallery.drawing import COLOURS, panels, save

Row = dict[str, Any]
CURVES = ("ours, small", "ours, fast", "ours, small, pruned", "ours, small, merged", "ours, small, tuned",
          "version 2", "spz 3", "spz 4", "png grid", "sog")  # fmt: skip
"""Those that are drawn, in this order of colours; files of 79 bytes and more are left out."""
MORE = ("#882255", "#ee8866")
SPREAD = 0.1
"""Loss in dB up to which the axis is linear."""


SIDES = {"psnr_change": "held-out", "seen_change": "training"}


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write size_held-out.png and size_training.png into the folder, where rows have such losses.

    Args:
        rows: Rows of the size study.
        folder: Folder of the pictures.
    """
    found = []
    for side, name in SIDES.items():
        held = [row for row in rows if side in row]
        if held:
            found.append(folder / f"size_{name}.png")
            _losses(held, side, name, found[-1])
    return found


def _losses(rows: Sequence[Row], side: str, name: str, path: Path) -> None:
    """One picture: a panel a scene."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = panels(len(scenes), width=4.6 * max(len(scenes), 2), ratio=0.9)
    for scene, axis in zip(scenes, axes, strict=True):
        mine = [row for row in rows if row["scene"] == scene]
        for colour, curve in zip((*COLOURS, *MORE), CURVES, strict=True):
            points = sorted((r["bytes_each"], -r[side]) for r in mine if r["curve"] == curve)
            if points:
                line = "-" if len(points) > 1 else ""
                axis.plot(*zip(*points, strict=True), line, marker="o", ms=4, lw=1.2, color=colour,
                          label=curve)  # fmt: skip
        axis.axhline(SPREAD, color="#bbbbbb", lw=0.8, zorder=0)
        axis.set_xscale("log")
        axis.set_yscale("symlog", linthresh=SPREAD)
        ticks = (5, 7, 10, 14, 20, 30, 50, 80)
        axis.set_xticks(ticks, [str(t) for t in ticks])
        axis.minorticks_off()
        losses = (-0.2, -0.1, -0.05, 0, 0.05, 0.1, 0.2, 0.5, 1, 2, 5)
        axis.set_yticks(losses, [f"{t:g}" for t in losses])
        axis.set_ylim(lowest_shown([-row[side] for row in mine]), None)
        axis.set_xlabel("bytes a Gaussian")
        axis.set_ylabel(f"PSNR lost on {name} views (dB)")
        axis.set_title(
            f"{scene}: {mine[0]['primitives']:,} Gaussians, {mine[0]['psnr']:.2f} dB held out",
            fontsize=9,
        )
    fullest = max(axes, key=lambda axis: len(axis.get_legend_handles_labels()[0]))
    fullest.legend(fontsize=7, loc="upper left")
    save(figure, path)


def lowest_shown(losses: Sequence[float]) -> float:
    """Lower end of the axis of losses: a file that is better than its model, as a tuned one can be, is shown too.

    Args:
        losses: PSNR lost by each row, dB; below 0 where it gains.
    """
    return min(-SPREAD / 2, 1.2 * min(losses))
