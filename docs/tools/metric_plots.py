"""How each metric answers to four faults of growing size, drawn on one picture; Sphinx calls it."""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image
from scipy import ndimage
from torch import Tensor

from splatproof.metrics.registry import BUILT_IN, Metric

DOCS = Path(__file__).parents[1]
PICTURE = DOCS / "images" / "world_courtyard.jpg"
CROP = (240, 0, 480, 176)
"""One of the pictures in it: left, top, right, bottom in pixels."""
SIZES = (0.5, 1.0, 2.0, 4.0)
"""Size of a fault, in the unit of its label."""
Fault = Callable[[Float[np.ndarray, "h w 3"], float], Float[np.ndarray, "h w 3"]]


def _noise(image: np.ndarray, size: float) -> np.ndarray:
    return image + np.random.default_rng(0).normal(0, 0.05 * size, image.shape)


def _blur(image: np.ndarray, size: float) -> np.ndarray:
    return ndimage.gaussian_filter(image, (size, size, 0))


def _shift(image: np.ndarray, size: float) -> np.ndarray:
    return ndimage.shift(image, (0, size, 0), order=1, mode="nearest")


def _gain(image: np.ndarray, size: float) -> np.ndarray:
    return image * (1 + 0.1 * size)


FAULTS: dict[str, tuple[Fault, str, str]] = {
    "noise, 0.05 x size": (_noise, "#2a78d6", "o"),
    "blur, size in pixels": (_blur, "#1baf7a", "s"),
    "shift, size in pixels": (_shift, "#eb6834", "^"),
    "gain, 10 % x size": (_gain, "#4a3aa7", "D"),
}
"""Fault by its label, with its colour and marker."""


def draw(folder: Path) -> dict[str, str]:
    """Draw the plots that are not there yet, or are older than what they show.

    Args:
        folder: Where they go.
    Returns: File name of each metric's plot; metrics whose weights are not public have none.
    """
    folder.mkdir(exist_ok=True)
    sources = [PICTURE, Path(__file__), *(DOCS.parent / "metrics").glob("*.py")]
    newest = max(path.stat().st_mtime for path in sources)
    drawn = {}
    for name, metric in BUILT_IN.items():
        if metric.load_weights is not None:
            continue
        path = folder / f"{name}.png"
        if not path.exists() or path.stat().st_mtime < newest:
            _plot(metric, path)
        drawn[name] = path.name
    return drawn


def answers(metric: Metric) -> dict[str, list[float]]:
    """Value of the metric for each fault and size."""
    truth = _picture()
    return {
        label: [metric.function(_tensor(fault(truth, size)), _tensor(truth), None) for size in SIZES]
        for label, (fault, _, _) in FAULTS.items()
    }  # fmt: skip


def _plot(metric: Metric, path: Path) -> None:
    with matplotlib.rc_context({"font.size": 9}):
        figure = Figure(figsize=(5.2, 3.0), layout="constrained", dpi=110)
        axes = figure.add_subplot()
        for label, values in answers(metric).items():
            _, colour, marker = FAULTS[label]
            axes.plot(SIZES, values, color=colour, marker=marker, markersize=4, label=label)
        axes.set_xscale("log", base=2)
        axes.set_xticks(SIZES, [f"{size:g}" for size in SIZES])
        axes.set_xlabel("size of the fault")
        axes.set_ylabel(f"{metric.name}{f' [{metric.unit}]' if metric.unit else ''}")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#dddddd", linewidth=0.6)
        axes.legend(frameon=False, fontsize=8)
        figure.savefig(path)


def _picture() -> Float[np.ndarray, "h w 3"]:
    image = Image.open(PICTURE).convert("RGB").crop(CROP)
    return np.asarray(image, dtype=np.float64) / 255


def _tensor(image: Float[np.ndarray, "h w 3"]) -> Float[Tensor, "h w 3"]:
    return torch.from_numpy(image.clip(0, 1)).float()
