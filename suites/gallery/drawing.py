"""What the pictures share: figures without a screen, images with titles, saving."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splatproof.base.files import whole_file

matplotlib.use("Agg")

COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb", "#222222")
"""Eight colours that stay apart for colour-blind readers (Paul Tol's bright scheme, and black)."""


def panels(columns: int, *, width: float = 10.0, ratio: float = 0.75) -> tuple[Figure, list[Axes]]:
    """A figure with one row of panels.

    Args:
        columns: Number of panels.
        width: Width of the figure in inches, at 100 dots an inch.
        ratio: Height of a panel over its width.
    """
    figure = Figure(figsize=(width, width / columns * ratio + 0.4), dpi=100, layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    return figure, list(axes)


def show_image(axes: Axes, image: np.ndarray, title: str, **options: Any) -> None:
    """An image or map without ticks under its title.

    Args:
        axes: Panel to draw on.
        image: Image, or a map of one value a pixel.
        title: Line above it.
        options: Further arguments of matplotlib's imshow.
    """
    axes.imshow(image, interpolation="nearest", **options)
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def show_plan(axes: Axes, title: str) -> None:
    """Equal scales and a title for a map seen from above.

    Args:
        axes: Panel that holds the map.
        title: Line above it.
    """
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=7)


def save(figure: Figure, path: Path) -> None:
    """Write a PNG, atomically.

    Args:
        figure: Picture to write.
        path: PNG file; its folder is made.
    """
    with whole_file(path) as partial:
        figure.savefig(partial, format="png")
