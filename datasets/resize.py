"""Sizes, intrinsics and pixels of a down-scaled image: the one tested place for all three."""

import math

import cv2
import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.protocol import Protocol

_PIL_FILTERS = {
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos": Image.Resampling.LANCZOS,
}
FILTER_RADIUS = {"area": 0.5, "bilinear": 1.0, "bicubic": 2.0, "lanczos": 3.0}
"""Half-width of each filter in pixels of the smaller image."""


def scaled_size(width: int, height: int, protocol: Protocol) -> tuple[int, int]:
    """Whole-pixel size of an image under a protocol: (w s, h s) with s = W / w or 1 / factor.

    With `protocol.width` the width is exact and only the height follows the size rule; so it is
    with `protocol.max_width` where an image is wider.

    Args:
        width: Width of the full-size (undistorted) image in pixels.
        height: Height of the full-size image in pixels.
        protocol: Gives `width`, `factor` or `max_width`, and `size_rule`: "round" is half up, not
            to even.

    Returns: (width, height), each at least 1.
    Raises: UsageError if the protocol would enlarge the image or its numbers make no sense.
    """
    for name in ("width", "max_width"):
        value = getattr(protocol, name)
        if value is not None and value < 1:
            raise UsageError(f"protocol {protocol.name}: {name} is {value}, expected >= 1")
    wanted = protocol.width
    if protocol.max_width is not None and width > protocol.max_width:
        wanted = protocol.max_width
    if wanted is not None:
        # integers: height * W / w exactly, so a half is a half and not 0.4999...
        pixels = (wanted, _divide(height * wanted, width, protocol.size_rule))
    else:
        if not (math.isfinite(protocol.factor) and protocol.factor >= 1):
            raise UsageError(
                f"protocol {protocol.name}: factor is {protocol.factor}, expected >= 1 "
                "(truth images are never enlarged)"
            )
        numerator, denominator = float(protocol.factor).as_integer_ratio()
        pixels = (
            _divide(width * denominator, numerator, protocol.size_rule),
            _divide(height * denominator, numerator, protocol.size_rule),
        )
    if pixels[0] > width or pixels[1] > height:
        raise UsageError(
            f"protocol {protocol.name}: asks for {pixels[0]} x {pixels[1]} but the undistorted "
            f"image is {width} x {height}; truth images are never enlarged, take width <= {width}"
        )
    return max(pixels[0], 1), max(pixels[1], 1)


def _divide(numerator: int, denominator: int, rule: str) -> int:
    """Whole number nearest to the quotient (half up), or below it."""
    if rule == "floor":
        return numerator // denominator
    return (2 * numerator + denominator) // (2 * denominator)


def scale_intrinsics(
    K: Float[Tensor, "3 3"], old: tuple[int, int], new: tuple[int, int]
) -> Float[Tensor, "3 3"]:
    """Intrinsics after resampling: K' = diag(w'/w, h'/h, 1) K, each axis by its own exact ratio.

    Pixel centres lie at .5, so the image covers [0, w] and the principal point scales like any
    position; with centres at whole numbers it would need (c + 0.5) s - 0.5.

    Args:
        K: Intrinsics in pixels of the old size.
        old: (width, height) before.
        new: (width, height) after.
    """
    ratio = torch.tensor([new[0] / old[0], new[1] / old[1], 1.0], dtype=K.dtype, device=K.device)
    return ratio[:, None] * K


def resample(
    image: Float[Tensor, "h w 3"], size: tuple[int, int], filter: str
) -> Float[Tensor, "h2 w2 3"]:
    """Down-scale an image, each filter stretched by the ratio so that nothing aliases.

    "area" is the exact mean over each new pixel's rectangle (OpenCV INTER_AREA); "lanczos"
    (a = 3), "bicubic" (a = -0.5) and "bilinear" (a triangle) are Pillow's, on float channels, in
    sRGB as stored, without any 8-bit step; overshoot is clamped to [0, 1].

    Args:
        image: Float32 in [0, 1].
        size: (width, height), at most the image's.
        filter: "area", "lanczos", "bicubic" or "bilinear".

    Returns: The image at the new size; the same tensor if the size is already right.
    """
    if size == (image.shape[1], image.shape[0]):
        return image
    pixels = image.contiguous().numpy()
    if filter == "area":
        return torch.from_numpy(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    channels = [
        np.asarray(Image.fromarray(pixels[..., c]).resize(size, _PIL_FILTERS[filter]))
        for c in range(3)
    ]
    return torch.from_numpy(np.stack(channels, axis=-1)).clamp(0, 1)
