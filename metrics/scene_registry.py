"""Every metric of a whole scene by its name: seams, balance of blocks, true depth and geometry."""

import math
from dataclasses import dataclass

from splatproof.metrics.parts import SEEN_SHARE


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


SEAM_MASKS = {
    "": "StitchGS, Sec. 5.1, over the paper's seam mask: near what a merge kept beyond its own block (metrics/seam.py)",
    "_partition": "StitchGS, Sec. 5.1, over the partition's seam mask (metrics/seam_partition.py)",
}
"""Ends of names, and over which pixels they are scored."""
RELEASED = (
    "as StitchGS's release is understood (metrics/seam_released.py), over the rims of boxes widened by "
    "15 %, at the rendered depth"
)


def _seams(suffix: str, mask: str) -> tuple[SceneMetric, ...]:
    literal = "channels summed, as the paper reads literally"
    return (
        _metric(f"seam_psnr{suffix}", f"{mask}; per-channel mean", True, "dB"),
        _metric(f"seam_psnr_sum{suffix}", f"{mask}; {literal}", True, "dB"),
        _metric(f"bpd_l1{suffix}", f"{mask}; per-channel mean", most=1.0),
        _metric(f"bpd_l1_sum{suffix}", f"{mask}; {literal}", most=3.0),
        _metric(f"nbgj{suffix}", mask),
        _metric(f"seam_coverage{suffix}", mask, None, most=1.0),
    )


BLOCKS = ("load", "views", "points", "primitives", "seconds", "cpu", "memory")
"""What is compared over blocks: observations, training views, points, Gaussians, training seconds,
processor seconds, peak memory."""
STAGES = ("coarse", "partition", "blocks", "stitch", "refine", "compress", "score")
"""Stages of a scene in blocks whose peak memory is told; score: of its held-out views."""
DEPTH = "Eigen et al. 2014, rendered against true z-depth, mean over the scored views that have it"
TRUTH = "depth of the training views, back-projected, against the true surface that they see"

MARKS = (10, 30, 60)
"""Seconds of training whose scores tables show; suites may keep models at others too."""

_ALL = (
    *(metric for suffix, mask in SEAM_MASKS.items() for metric in _seams(suffix, mask)),
    _metric("seam_psnr_released", f"{RELEASED}; mean over views", True, "dB"),
    _metric("seam_l1_released", f"{RELEASED}; mean over views", most=1.0),
    _metric("seam_gradient_ratio_released", f"{RELEASED}; on the seam over off it"),
    _metric("seam_depth_gradient_ratio_released", f"{RELEASED}; on the seam over off it"),
    *(
        _metric(f"{what}_{ratio}_over_mean", f"{ratio} / mean over blocks of their {what}")
        for what in BLOCKS
        for ratio in ("std", "max")
    ),
    _metric("four_machine_seconds", "wall seconds if four machines had trained the blocks, longest first, and one did "
            "all other stages (suites/scene_scores/block_balance.py)", unit="s"),
    _metric("four_machine_cpu_seconds", "the same of processor seconds, which other work on the machine changes less; of "
            "a model that is trained in one piece those of its whole case, scoring among them", unit="s"),
    _metric("block_densifications", "times that the block was densified that was so least", None),
    _metric("retention", "share of all blocks' trained Gaussians that the merge kept", None, most=1.0),
    _metric("over_hard_cut", "Gaussians that the merge kept over those that a hard cut of the same blocks keeps", None),
    *(
        _metric(f"{stage}_peak_mb", f"peak memory of the largest process of stage {stage}, in 2^20 bytes", unit="MB")
        for stage in STAGES
    ),
    _metric("edge_cut", "edges of a grid of voxels, 64 along the scene, between voxels of two blocks "
            "(methods/city/partition.py)"),
    _metric("packed_bytes", "bytes of the compressed file, without facts about blocks", unit="B"),
    _metric("depth_abs_rel", f"{DEPTH}: abs(d - t) / t"),
    _metric("depth_sq_rel", f"{DEPTH}: (d - t)^2 / t", unit="scene units"),
    _metric("depth_rmse", f"{DEPTH}: root of (d - t)^2", unit="scene units"),
    *(
        _metric(f"depth_delta{k}", f"{DEPTH}: share off by a factor below 1.25^{k}", True, most=1.0)
        for k in (1, 2, 3)
    ),
    _metric("depth_share", f"{DEPTH}: share of pixels with known depth", None, most=1.0),
    _metric("geometry_accuracy", f"{TRUTH}: mean distance", unit="scene units"),
    _metric("geometry_completeness", f"{TRUTH}: share found", True, most=1.0),
    _metric("geometry_f_score", TRUTH, True, most=1.0),
    _metric("geometry_blind_completeness", "share found of the facades that only test views see",
            True, most=1.0),
    *(
        _metric(f"{name}_{mark}s", f"{name} of the model as it was {mark} s after its scene was opened",
                better, unit, most=most)
        for name, better, unit, most in (
            ("psnr", True, "dB", math.inf), ("ssim_3dgs", True, "", 1.0), ("flip", False, "", 1.0),
        )
        for mark in MARKS
    ),
    _metric("time_to_95", "wall seconds after which 95 % of the gain in PSNR from the first to the last "
            "mark is reached for good, linear between marks (suites/marks.py)", unit="s"),
    *(
        _metric(f"{part}_seconds", f"wall seconds of threads that {does} photos beside the training, all together, since the "
                "scene was opened (datasets/reading_clock.py); of the last attempt, if there were several", unit="s")
        for part, does in (("decode", "decode"), ("undistort", "undistort"), ("resize", "make smaller"))
    ),
    _metric("training_gap", "PSNR of up to eight training views minus that of the held-out ones", unit="dB"),
    _metric(SEEN_SHARE, "share of the scored pixels that a training photo can have shown (docs/seen.md)",
            None, most=1.0),
)  # fmt: skip

SCENE_METRICS: dict[str, SceneMetric] = {metric.name: metric for metric in _ALL}
"""Metrics of a scene by name, in the order in which tables show them."""
