"""How much an image's edges differ from the truth's: blur and halos, whatever the colours."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import Pair, check_pair, mean_over
from splatproof.metrics.ssim import windows_valid

WINDOW = 3
"""Side of the Sobel filters in pixels."""
LARGEST = 0.5**0.5
"""No gradient is longer: either of its two parts lies in [-1/2, 1/2]."""


def gradient_l1(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean difference of gradient magnitudes, | |grad I| - |grad T| |, in each channel.

    Args:
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over pixels whose 3x3 window, as far as it
            lies inside the image, is fully valid.
    Returns: In [0, sqrt(1/2)], change of value a pixel, 0 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: ours, with kornia's Sobel filters (kornia.filters.spatial_gradient).
    """
    pair = check_pair(image, target, mask, metric="gradient_l1")
    counted = windows_valid(pair.valid, WINDOW, beyond_border=True)
    return mean_over(gradient_map(pair), counted)


def gradient_map(pair: Pair) -> Float[np.ndarray, "h w 3"]:
    """The difference of gradient magnitudes at each pixel and channel."""
    return np.abs(magnitude(pair.image) - magnitude(pair.target))


def magnitude(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Length of each channel's gradient: Sobel filters over 8, borders repeated.

    Args:
        image: In [0, 1].
    """
    from kornia.filters import spatial_gradient  # slow to import, needed here alone

    channels = torch.from_numpy(image).permute(2, 0, 1)[None]
    return spatial_gradient(channels)[0].norm(dim=1).permute(1, 2, 0).numpy()
