"""The share of what the machine could do that each stage of the engine reaches."""

import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

from splatproof import _ext
from splatproof.methods.kernels import adam, loss
from splatproof.methods.kernels.roofline import Pairs, Peak, count_pairs, measure_peak
from splatproof.methods.kernels.step import ViewGradients
from splatproof.suites.case_costs import timed
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene
from splatproof.suites.studies.speed.idle import SHARE, Patience, undisturbed
from splatproof.suites.twins.random_scenes import speed_scene

SIZE, QUICK_SIZE = (100_000, 800, 600), (2_000, 160, 120)
DEGREE, NUMBERS = 3, 59
"""Degree of the harmonics, and parameters of a Gaussian with them."""
PROJECTED_BYTES = 101
"""Written a Gaussian: 16 numbers of its ellipse, 8 of its features, radius and a flag."""
SORT_BYTES = 3 * 2 * 8
"""A Gaussian in a radix sort of 32-bit keys with 32-bit values: three passes, each read and write."""
SUM_BYTES = 4 * 11
"""Read a Gaussian after the blend's backward pass: its sums over the pixels, once."""
ADAM_BYTES = 28
"""A number: value, gradient and two moments read, value and moments written."""
LOSS_FLOPS = 2 * 22 * (5 + 3)
"""A pixel and channel: separable blurs of 11 taps, five maps forward and three backward."""


@dataclass(frozen=True, kw_only=True)
class Floor:
    """The least time that a stage could take, and what bounds it."""

    seconds: float
    bound: str


def rows(*, quick: bool, patience: Patience) -> Iterator[dict[str, Any]]:
    """Peaks of the machine at each level of SIMD (keys value, unit), then a row a stage with floor_ms and share.

    The level in use comes first, then those below it; of machines with vectors the portable one is left out,
    which nobody draws with there. Stages bound by memory are held against the bandwidth over as many bytes as
    they touch, so that what fits a cache is held against the cache.

    Args:
        quick: Measure briefly, and whatever others use of the machine.
        patience: How long to wait until nobody else uses the machine.
    """
    used = _ext.simd_level()
    levels = _ext.simd_levels()[: _ext.simd_levels().index(used) + 1]
    try:
        for level in reversed(levels[1:] or levels):
            _ext.set_simd_level(level)
            for row in _at_level(quick=quick, patience=patience):
                yield {**row, "level": level}
    finally:
        _ext.set_simd_level(used)


def _at_level(*, quick: bool, patience: Patience) -> Iterator[dict[str, Any]]:
    seconds = 0.02 if quick else 0.5
    peak, percent = undisturbed(partial(measure_peak, seconds), patience, anyway=quick)
    if peak is None:
        yield _row("peaks", "all threads", percent, ok=False, note="refused: others were at work")
        return
    for twin, value, unit in (
        ("multiply-adds", peak.flops / 1e9, "GFLOP/s"),
        ("blend forward", 1e9 / peak.blend_pairs, "ns a pair"),
        ("blend backward", 1e9 / peak.blend_backward_pairs, "ns a pair"),
        ("memory", peak.bytes / 1e9, "GB/s"),
    ):
        yield _row(twin, f"{_ext.simd_level()}, {torch.get_num_threads()} threads", percent,
                   value=value, unit=unit)  # fmt: skip
    size = QUICK_SIZE if quick else SIZE
    scene, _ = speed_scene(*size)
    pairs = count_pairs(scene.camera, scene.means, scene.quaternions, scene.scales, scene.opacities)
    runs = 3 if quick else 15
    measured, percent = undisturbed(lambda: stage_milliseconds(scene, runs), patience, anyway=quick)
    for stage, floor in floors(size, pairs, peak, 0.01 if quick else 0.1).items():
        ms = None if measured is None else measured[stage]
        note = f"others used {percent:.0f} % of a core" if percent > SHARE else ""
        yield _row(
            stage, f"{size[0]} {size[1]}x{size[2]}", percent, floor_ms=1e3 * floor.seconds,
            share=None if ms is None else 1e3 * floor.seconds / ms, bound=floor.bound,
            ok=ms is not None, note=note,
            **{"backward_ms" if stage.endswith("backward") else "forward_ms": ms},
        )  # fmt: skip


def _row(twin: str, case: str, percent: float, **values: Any) -> dict[str, Any]:
    empty = dict.fromkeys(("forward_ms", "backward_ms", "max_abs_error", "grad_rel_l2",
                           "discontinuity_pixels", "peak_mb"))  # fmt: skip
    return {
        "component": "roofline", "twin": twin, "case": case, **empty,
        "disturbed_percent": percent, "ok": True, "note": "", **values,
    }  # fmt: skip


def stage_milliseconds(scene: GaussianScene, runs: int) -> dict[str, float]:
    """Medians of the stages of one training step on this scene; the first run is not counted.

    Args:
        scene: Gaussians and the camera that looks at them.
        runs: Number of runs that the medians are of, >= 1.
    """
    seen: dict[str, list[float]] = {}
    truth = torch.zeros(scene.camera.height, scene.camera.width, 3)
    drawn = torch.zeros_like(truth).requires_grad_()
    values, steps = torch.zeros(len(scene.means), NUMBERS), torch.ones(len(scene.means), NUMBERS)
    moments = [torch.zeros_like(values) for _ in range(2)]
    parameters = {
        "means": scene.means, "quaternions": scene.quaternions, "log_scales": scene.scales.log(),
        "opacity_logits": scene.opacities.logit(), "sh_dc": scene.sh[:, :1].contiguous(),
        "sh_rest": scene.sh[:, 1:].contiguous(),
    }  # fmt: skip
    gradients = ViewGradients()
    for run in range(runs + 1):
        gradients.of(scene.camera, parameters, truth, degree=DEGREE)
        stages = {name: 1e3 * value for name, value in _ext.stage_seconds().items()}
        stages["loss"] = _milliseconds(partial(loss.photometric, drawn, truth))
        stages["adam"] = _milliseconds(
            partial(adam.step, [values], [steps], moments[:1], moments[1:], [1e-3], run + 1)
        )
        for name, ms in stages.items():
            seen.setdefault(name, []).append(ms)
    return {name: statistics.median(each[1:]) for name, each in seen.items()}


def _milliseconds(work: Callable[[], object]) -> float:
    stages: dict[str, float] = {}
    with timed(stages, "work"):
        work()
    return 1e3 * stages["work"]


def floors(size: tuple[int, ...], pairs: Pairs, peak: Peak, seconds: float) -> dict[str, Floor]:
    """The floor of each stage.

    Args:
        size: Gaussians, width, height.
        pairs: What the image needs.
        peak: What the machine does.
        seconds: How long each bandwidth is measured.
    """
    count, width, height = size

    def memory(bytes_each: int) -> Floor:
        total = count * bytes_each
        rate = measure_peak(seconds, total).bytes
        return Floor(seconds=total / rate, bound=f"memory, {rate / 1e9:.0f} GB/s")

    parameters = 4 * NUMBERS
    return {
        "project": memory(parameters + PROJECTED_BYTES),
        "bin": memory(SORT_BYTES),
        "blend": Floor(seconds=pairs.lanes / peak.blend_pairs, bound="blend loop"),
        "loss": Floor(seconds=LOSS_FLOPS * 3 * width * height / peak.flops, bound="multiply-adds"),
        "blend_backward": Floor(
            seconds=pairs.lanes / peak.blend_backward_pairs, bound="blend loop, backward"
        ),
        "project_backward": memory(2 * parameters + PROJECTED_BYTES + SUM_BYTES),
        "adam": memory(ADAM_BYTES * NUMBERS),
    }
