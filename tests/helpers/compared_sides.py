"""Sides of a comparison made of arrays: what runs would have measured, without runs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from splatproof.reports.comparing.bands import Band
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.sides import Side
from splatproof.reports.measured import Measured

RULES: dict[str, object] = {
    "name": "p",
    "metrics": ["psnr", "ssim_3dgs", "flip", "delta_e_2000"],
    "rounding": "round",
}
METRICS = ("psnr", "ssim_3dgs", "flip", "delta_e_2000")
SCALES = {"psnr": 1.0, "ssim_3dgs": 0.01, "flip": -0.02, "delta_e_2000": -0.3}
"""What a dB of PSNR is worth in each metric, in this made-up world."""


def band(value: float, unit: str = "dB") -> Band:
    """A declared band."""
    return Band(unit=unit, value=value, measured="test", command="none")


def case(scene: str, seed: int, scores: Mapping[str, np.ndarray], **changed) -> CaseRecord:
    """A finished case with scores of each image by metric."""
    count = len(next(iter(scores.values())))
    images = {
        f"view_{i}": {name: float(values[i]) for name, values in scores.items()}
        for i in range(count)
    }
    values = {name: float(np.mean(own)) for name, own in scores.items()} | changed.pop("values", {})
    run = {"scene": scene, "row": "3dgs", "protocol": "p", "seed": seed, "steps": 10, "grown": 2,
           "values": values, "images": images} | changed.pop("measured", {})  # fmt: skip
    plain: dict[str, Any] = {
        "suite": "s", "measured": Measured(**run), "rules": RULES, "settings": {"lr": 0.1},
        "environment": {"commit": "0123abcd", "python": "3.11"}, "split": "split",
        "truth": {name: f"sha of {name}" for name in images},
        "model": f"{scene}{seed}{np.concatenate(list(scores.values())).tobytes().hex()}",
    }  # fmt: skip
    return CaseRecord(**{**plain, **changed})


def drawn_side(
    rng: np.random.Generator,
    label: str,
    effect: float = 0.0,
    *,
    seeds: int = 3,
    images: int = 8,
    scenes: int = 2,
    noise: float = 0.05,
    interaction: float = 0.03,
    residual: float = 0.02,
    hard: np.ndarray | None = None,
    **changed,
) -> Side:
    """A side whose PSNR lies `effect` above the plain one, all metrics moved by the same causes.

    Args:
        noise: Standard deviation from seed to seed, dB.
        interaction: Of what is particular to this side in each image, dB.
        residual: Of each single score, dB.
        hard: How bright the images of each scene are, the same for both sides of a comparison.
    """
    cases = []
    for scene in range(scenes):
        own = np.zeros(images) if hard is None else hard[scene]
        particular = rng.normal(0, interaction, images)
        for seed in range(seeds):
            common = effect + rng.normal(0, noise) + particular + rng.normal(0, residual, images)
            scores = {
                name: scale * (own + common + rng.normal(0, residual, images)) + 10
                for name, scale in SCALES.items()
            }
            cases.append(case(f"scene_{scene}", seed, scores, **changed))
    return Side(label=label, cases=tuple(cases))


def drawn_pair(seed: int, effect: float = 0.0, **options) -> tuple[Side, Side]:
    """BASE and NEW on the same images, NEW better by `effect` dB."""
    rng = np.random.default_rng(seed)
    hard = rng.normal(24, 3, (options.get("scenes", 2), options.get("images", 8)))
    return (
        drawn_side(rng, "base", hard=hard, **options),
        drawn_side(rng, "new", effect, hard=hard, **options),
    )
