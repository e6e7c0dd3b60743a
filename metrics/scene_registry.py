"""Every metric of a whole scene by its name: seams, balance of blocks, true geometry."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SceneMetric:
    """How to read a value that no single pair of images gives."""

    name: str
    unit: str
    """Name of the unit; empty: none."""
    higher_is_better: bool | None
    """None: neither higher nor lower is better."""
    range: tuple[float, float]
    source: str


def _metric(
    name: str, source: str, better: bool | None = False, unit: str = "", most: float = math.inf
) -> SceneMetric:
    low = -math.inf if unit == "dB" else 0.0
    return SceneMetric(
        name=name, unit=unit, higher_is_better=better, range=(low, most), source=source
    )


SEAM = "StitchGS, Sec. 5.1, over the partition's seam mask (metrics/seam_partition.py)"
BLOCKS = ("load", "views", "points", "primitives", "seconds", "memory")
"""What is compared over blocks: observations, training views, points, Gaussians, training seconds,
peak memory."""
TRUTH = "depth of the training views, back-projected, against the true surface that they see"

_ALL = (
    _metric("seam_psnr", f"{SEAM}; per-channel mean", True, "dB"),
    _metric("seam_psnr_sum", f"{SEAM}; channels summed, as the paper reads literally", True, "dB"),
    _metric("bpd_l1", f"{SEAM}; per-channel mean", most=1.0),
    _metric("bpd_l1_sum", f"{SEAM}; channels summed, as the paper reads literally", most=3.0),
    _metric("nbgj", SEAM),
    _metric("seam_coverage", SEAM, None, most=1.0),
    *(
        _metric(f"{what}_{ratio}_over_mean", f"{ratio} / mean over blocks of their {what}")
        for what in BLOCKS
        for ratio in ("std", "max")
    ),
    _metric("packed_bytes", "bytes of the compressed file, without facts about blocks", unit="B"),
    _metric("geometry_accuracy", f"{TRUTH}: mean distance", unit="scene units"),
    _metric("geometry_completeness", f"{TRUTH}: share found", True, most=1.0),
    _metric("geometry_f_score", TRUTH, True, most=1.0),
    _metric("geometry_blind_completeness", "share found of the facades that only test views see",
            True, most=1.0),
)  # fmt: skip

SCENE_METRICS: dict[str, SceneMetric] = {metric.name: metric for metric in _ALL}
"""Metrics of a scene by name, in the order in which tables show them."""
