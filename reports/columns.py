"""What a leaderboard shows of a result: scores, time, memory and size, and how each is written."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from splatproof.base.errors import DataError
from splatproof.metrics.parts import PARTS, SEEN, SEEN_SHARE, is_part_key
from splatproof.metrics.registry import all_metrics
from splatproof.metrics.scene_registry import SCENE_METRICS
from splatproof.reference.types.result import Result
from splatproof.reports.frames import CASE
from splatproof.reports.statistics import Summary

MB = 2**20
FITS = {
    "cc_affine": "an affine fit of the render's colours to the truth's",
    "cc_quadratic": "a quadratic fit of the render's colours to the truth's",
}
"""Colour fits of a protocol, in words."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One value of a result, and how to read and write it."""

    key: str
    """Name in machine-readable output."""
    title: str
    about: str
    """What it is, for the legend: a phrase without a full stop."""
    unit: str = ""
    higher_is_better: bool | None = None
    """None: neither, so it ranks nothing and nothing in it is marked best."""
    digits: int = 4
    """After the point."""
    source: str
    """Column of `results_frame` that has the case's value."""
    scale: float = 1.0
    """What the source's values are multiplied by."""
    per_image: bool = False
    """Whether every image has a value of its own under this key."""
    aside: Callable[[float], str] | None = None
    """What is written in brackets behind the number."""
    of_the_machine: bool = False
    """Whether it depends on where it was measured."""

    def values(self, cases: pd.DataFrame) -> Float[np.ndarray, " _"]:
        """The value of each case; nan where it was not measured.

        Args:
            cases: A row a case, of `frames.cases_of`.
        """
        if self.source not in cases:
            return np.full(len(cases), np.nan)
        return cases[self.source].to_numpy(dtype=np.float64) * self.scale

    @property
    def heading(self) -> str:
        """Title, unit and an arrow that points to the better side."""
        arrow = {True: " ↑", False: " ↓", None: ""}[self.higher_is_better]
        return self.title + (f" [{self.unit}]" if self.unit else "") + arrow

    def text(self, value: float) -> str:
        """The number as people read it; a dash where it is undefined."""
        if math.isnan(value):
            return "–"
        number = "∞" if math.isinf(value) else f"{value:,.{self.digits}f}"
        aside = self.aside(value) if self.aside else ""
        return f"{number} ({aside})" if aside else number

    def with_interval(self, summary: Summary) -> str:
        """Mean ± half the 95 % interval; the mean alone where there is no interval."""
        half = (summary.high - summary.low) / 2
        if math.isnan(half):
            return self.text(summary.mean)
        return f"{self.text(summary.mean)} ± {self.text(half)}"


def columns(rules: dict[str, object], results: list[Result]) -> tuple[Column, ...]:
    """The protocol's metrics, first the one that ranks, then all others that any result has.

    Args:
        rules: protocol_rules of the results.
        results: All under that protocol.
    Raises: DataError where the rules name no metric.
    """
    named = rules.get("metrics")
    if not isinstance(named, (list, tuple)) or not named:
        raise DataError(
            f"protocol {rules.get('name')!r}: its rules name no metrics; expected a list of "
            "names, the first of which ranks"
        )
    scored = {name for result in results for image in result.images for name in image.metrics}
    found = {name: None for result in results for name in result.metrics}
    first, *others = map(str, named)
    ordered = [first, *(name for name in others if name in found)]
    ordered += [name for name in found if name not in ordered]
    return (*(score_column(name, name in scored) for name in ordered), *COSTS)


def score_column(name: str, per_image: bool) -> Column:
    """The column of a metric; what is known of `psnr` holds for cc_affine_psnr, psnr_of_mean_mse.

    Args:
        name: Name of the metric, ours, of another package or of none that is known.
        per_image: Whether any image has a value of that name.
    """
    plain, said = name.removesuffix("_of_mean_mse"), ""
    if plain != name:
        said = "of the mean squared error over all images, not the mean of each image's: "
    over_part = is_part_key(name)
    for part in (*PARTS, SEEN) if over_part and name != SEEN_SHARE else ():
        if plain.startswith(f"{part}_"):
            plain, said = plain.removeprefix(f"{part}_"), f"{said}over the part {part!r}: "
    for fit, words in FITS.items():
        if plain.startswith(f"{fit}_"):
            plain, said = plain.removeprefix(f"{fit}_"), f"{said}after {words}: "
    metric = all_metrics().get(plain) or SCENE_METRICS.get(plain)
    unit = metric.unit if metric else ""
    return Column(
        key=name,
        title=name,
        about=said + (metric.source if metric else "not known to this release"),
        unit=unit,
        higher_is_better=metric.higher_is_better if metric else None,
        digits=2 if unit == "dB" else 4,
        source=CASE + name,
        # images without the part have no value; nearly all have a seen one
        per_image=per_image
        and (not over_part or name.startswith(SEEN))
        and (name == SEEN_SHARE or name not in SCENE_METRICS),
    )


COSTS = (
    Column(
        key="train_seconds",
        title="train",
        about="wall seconds of training, all stages of the method; loading and scoring apart",
        unit="s",
        higher_is_better=False,
        digits=1,
        source="train_seconds",
        of_the_machine=True,
    ),
    Column(
        key="render_ms",
        title="render",
        about="median milliseconds of a test frame after warm-up, without reading or writing",
        unit="ms",
        higher_is_better=False,
        digits=1,
        source="render_ms",
        aside=lambda ms: f"{1000 / ms:,.0f} FPS" if ms > 0 else "",
        of_the_machine=True,
    ),
    Column(
        key="primitives",
        title="primitives",
        about="Gaussians of the saved model, or its anchors, of which each becomes several",
        digits=0,
        source="primitives",
    ),
    Column(
        key="disk_mb",
        title="disk",
        about="bytes of the saved model",
        unit="MB",
        higher_is_better=False,
        digits=1,
        source="bytes_on_disk",
        scale=1 / MB,
    ),
    Column(
        key="peak_memory_mb",
        title="peak memory",
        about="most resident memory of the process that trained and scored",
        unit="MB",
        higher_is_better=False,
        digits=0,
        source="peak_memory_mb",
        of_the_machine=True,
    ),
)
"""What a result costs, beside every score. 1 MB is 2^20 bytes; FPS follows from the median frame."""
