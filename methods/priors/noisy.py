"""Prior `oracle+noise`: the true depth, wrong in the ways in which a network's is."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float32

from splatproof.methods.priors import oracle
from splatproof.reference.types.scene import DepthPrior, Scene

BLUR = 0.006
"""Standard deviation of the blur as a share of the image's width: edges of depth are soft."""
BEND = 0.2
"""Standard deviation of the logarithm of the exponent that disparity is raised to."""
WAVES = 0.12
"""Standard deviation of the smooth factor on disparity (of its logarithm)."""
CELLS = 6
"""Knots of the smooth factor along the longer side."""
STRETCH, SHIFT = 0.5, 0.2
"""Standard deviations of the logarithm of the scale, and of the zero point as a share of it."""


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene.

    Args:
        scene: A scene whose training views know their true depth.
        weights: None; it has none.
        seed: Seed of the disturbance; each view draws its own by its name.
    Raises: UsageError where a training view has no true depth.
    """
    oracle.require_truth(scene, "oracle+noise")

    def make(index: int) -> DepthPrior:
        name = hashlib.sha256(scene.views[index].name.encode()).digest()[:8]
        rng = np.random.Generator(np.random.PCG64([seed, int.from_bytes(name, "little")]))
        return disturbed(oracle.prior_of(oracle.true_depth(scene, index)), rng)

    return make


def disturbed(truth: DepthPrior, rng: np.random.Generator) -> DepthPrior:
    """Disparity with soft edges, a smooth error, a monotone warp, and a scale and zero of its own.

    d' = a ((G * d) / m)^g exp(w) + b with a Gaussian blur G, m the 95th percentile of d, log g, w,
    log a and b normal. After the best scale and zero are put back, AbsRel is 0.118 on the
    world street and 0.073 in the tunnel (`bench study priors`), as that of monocular networks on
    driving scenes.

    Args:
        truth: True disparity.
        rng: What is drawn from.
    Source: ours.
    """
    height, width = truth.disparity.shape
    known = truth.disparity.numpy()
    soft = cv2.GaussianBlur(known, (0, 0), BLUR * width, borderType=cv2.BORDER_REPLICATE)
    level = np.quantile(known[truth.valid.numpy()], 0.95) if truth.valid.any() else 1.0
    bent = (soft / max(float(level), 1e-12)) ** np.exp(BEND * rng.standard_normal())
    bent = bent * np.exp(WAVES * _waves(height, width, rng))
    scale, zero = np.exp(STRETCH * rng.standard_normal()), SHIFT * rng.standard_normal()
    disparity = torch.from_numpy((scale * (bent + zero)).astype(np.float32))
    return DepthPrior(disparity=disparity, valid=truth.valid)


def _waves(height: int, width: int, rng: np.random.Generator) -> Float32[np.ndarray, "h w"]:
    """A smooth field of deviation 1 at its knots."""
    cell = max(height, width) / CELLS
    knots = rng.standard_normal((2 + int(height / cell), 2 + int(width / cell)))
    return cv2.resize(knots.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
