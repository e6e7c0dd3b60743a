"""Metrics that look at each pixel alone."""

import math

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import check_pair, mean_over


def psnr(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Peak signal-to-noise ratio, -10 log10(MSE), with the peak fixed at 1.

    Args:
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the MSE is the mean over these and the channels.
    Returns: dB, >= 0; inf where the two are equal; nan where no pixel counts.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: baseline practice of every harness; the peak is never guessed from the data.

    >>> import torch
    >>> round(psnr(torch.zeros(2, 2, 3), torch.full((2, 2, 3), 0.1)), 4)
    20.0
    """
    pair = check_pair(image, target, mask, metric="psnr")
    return psnr_of_mse(mean_over((pair.image - pair.target) ** 2, pair.valid))


def psnr_of_mse(mse: float) -> float:
    """-10 log10(mse) in dB; inf for 0, nan for nan."""
    return math.inf if mse == 0 else -10 * math.log10(mse)


def l1(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean absolute difference over valid pixels and channels; nan where no pixel counts.

    Args:
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel counts.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: ours.
    """
    pair = check_pair(image, target, mask, metric="l1")
    return mean_over(np.abs(pair.image - pair.target), pair.valid)
