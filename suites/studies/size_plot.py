"""Picture of the size study: bytes against the loss of PSNR, and what the bytes are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splatproof.methods.storage.packed.writer import PARTS
from splatproof.suites.gallery.drawing import COLOURS, panels, save

Row = dict[str, Any]


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write size.png into the folder; nothing where no row has a size.

    Args:
        rows: Rows of the size study.
        folder: Folder of the picture.
    """
    held = [row for row in rows if "bytes_each" in row]
    if not held:
        return []
    figure, (left, right) = panels(2, width=13.0, ratio=0.7)
    swept = sorted((r for r in held if r["format"].startswith("gate 0")), key=lambda r: r["gate"])
    left.plot([r["bytes_each"] for r in swept], [-r["psnr_change"] for r in swept],
              color=COLOURS[0], lw=1, zorder=1)  # fmt: skip
    for row in held:
        kind = 2 if row["format"].startswith("spz") else 0 if row in swept else 1
        at = (row["bytes_each"], -row["psnr_change"])
        left.scatter(*at, s=22, color=COLOURS[kind], zorder=2)
    for x, y, names in _together(held):
        label = left.annotate(names, (x, y), xytext=(0, 5), textcoords="offset points",
                              fontsize=7, rotation=90, ha="center", va="bottom")  # fmt: skip
        label.set_in_layout(False)  # many names at one place would leave no room for the axes
    left.set_xscale("log")
    left.set_xticks([20, 30, 50, 80, 120, 240], ["20", "30", "50", "80", "120", "240"])
    left.minorticks_off()
    left.margins(0.1, 0.3)
    left.set_xlabel("bytes a primitive")
    left.set_ylabel("PSNR lost on held-out views (dB)")
    left.set_title(f"{held[0]['scene']}: {held[0]['primitives']} primitives, "
                   f"{held[0]['psnr']:.2f} dB", fontsize=9)  # fmt: skip
    split = [row for row in held if "positions" in row]
    start = np.zeros(len(split))
    for i, part in enumerate(PARTS):
        size = np.array([row[part] for row in split])
        right.barh([row["format"] for row in split], size, left=start, color=COLOURS[i], label=part)
        start += size
    right.invert_yaxis()
    right.legend(fontsize=7)
    right.tick_params(labelsize=8)
    right.set_xlabel("bytes a primitive, by part")
    save(figure, folder / "size.png")
    return [folder / "size.png"]


def _together(rows: Sequence[Row]) -> list[tuple[float, float, str]]:
    """Where to write which names: rows that lie on one another share a label."""
    labels: list[tuple[float, float, list[str]]] = []
    for row in rows:
        x, y = row["bytes_each"], -row["psnr_change"]
        near = [held for a, b, held in labels if abs(a / x - 1) < 0.04 and abs(b - y) < 0.03]
        if near:
            near[0].append(row["format"])
        else:
            labels.append((x, y, [row["format"]]))
    return [(x, y, ", ".join(names)) for x, y, names in labels]
