"""FLIP: the perceptual difference between two images that are flipped back and forth."""

import hashlib
from collections import deque

import flip_evaluator
import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import Pair, check_pair, mean_over

_LAST: deque[tuple[tuple, np.ndarray]] = deque(maxlen=2)
"""The last maps by what they were made of: an image's own and that after a colour fit."""


def flip(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean of the LDR-FLIP error map at 67 pixels per degree of visual angle.

    That is FLIP's default viewing condition: a 0.7 m wide 3840 px display at 0.7 m. About 1 us a
    pixel on one core, so 40 ms at 250 x 140 and 0.6 s at 1000 x 560.

    Args:
        image: What is scored, sRGB in [0, 1].
        target: The truth, sRGB in [0, 1].
        mask: True where a pixel counts; the mean is then over valid pixels of the map. Invalid
            pixels are black in both images before the map is made (its filters reach beyond
            the mask), so their content cannot matter.
    Returns: In [0, 1], 0 for equal images; nan where no pixel counts.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images", as
        NVIDIA's flip-evaluator computes it.
    """
    pair = check_pair(image, target, mask, metric="flip")
    return mean_over(flip_map(pair), pair.valid)


def flip_map(pair: Pair) -> Float[np.ndarray, "h w"]:
    """FLIP's error at each pixel, in [0, 1].

    The last maps are kept: a render is looked at whole, by parts and as a picture of its errors,
    and its map is the longest of all metrics to make.
    """
    target, image = (one.astype(np.float32) for one in (pair.target, pair.image))
    key = (target.shape, *(hashlib.blake2b(one.tobytes()).digest() for one in (target, image)))
    known = dict(_LAST)
    if key not in known:
        error, _, _ = flip_evaluator.evaluate(
            target, image, "LDR", applyMagma=False, computeMeanError=False
        )
        known[key] = error[..., 0]
        _LAST.append((key, known[key]))
    return known[key].astype(np.float64)
