"""Metrics over a part of an image: what moves, what stands still, or what training photos show."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.colour_difference import delta_e_76_map, delta_e_2000_map
from splatproof.metrics.gradient import gradient_map
from splatproof.metrics.ldr_flip import flip_map
from splatproof.metrics.pairs import Pair, check_pair, mean_over
from splatproof.metrics.pixel import psnr_of_mse
from splatproof.metrics.ssim import (
    WINDOW,
    contrast_map,
    kornia_map,
    skimage_map,
    ssim_map,
    windows_valid,
)

PARTS = ("moving", "vehicles", "people", "still")
"""What `Protocol.parts` may name: all that moves, either kind of it, all that does not."""
SEEN = "seen"
"""The part that some training photo can have shown; scored under every protocol, see seen_part.py."""
SEEN_SHARE = "seen_share"
"""Name of its share of the scored pixels."""


def parts_of(moving: Mapping[str, Bool[Tensor, "h w"]]) -> dict[str, Bool[Tensor, "h w"]]:
    """Masks of the parts of an image.

    Args:
        moving: Masks of "vehicles" and "people" that move, as `View.load_moving` reads them.
    """
    anything = torch.stack(list(moving.values())).any(dim=0)
    return {**moving, "moving": anything, "still": ~anything}


def score_part(
    metric: str,
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None,
    part: Bool[Tensor, "_h _w"],
) -> float:
    """A metric over the valid pixels of a part, nan where there is none.

    PSNR of these pixels; of the others the mean of the whole image's map over them, so that a window
    of SSIM at the rim of a part looks beyond it, as the release of OmniRe does.

    Args:
        metric: Name of a metric in OVER.
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel counts; None: everywhere.
        part: True where a pixel belongs to the part.
    Source: Chen et al. 2025 (OmniRe), release drivestudio: models/video_utils.py.
    """
    pair = check_pair(image, target, mask, metric=metric)
    where = pair.valid & part.detach().cpu().numpy()
    return OVER[metric](pair, where) if where.any() else math.nan


def part_key(part: str, metric: str) -> str:
    """Name of a metric over a part, such as moving_psnr.

    Args:
        part: Name of the part, SEEN or one of PARTS.
        metric: Name of a metric in OVER.
    """
    return f"{part}_{metric}"


def is_part_key(key: str) -> bool:
    """Whether a metric's name is one over a part, or says how large a part is."""
    return key == SEEN_SHARE or any(
        key == part_key(part, metric) for part in (*PARTS, SEEN) for metric in OVER
    )


def mean_over_images(values: Sequence[float]) -> float:
    """Mean over the images that have any pixel of the part; nan where none has.

    Which images these are the truth alone decides, so it is the same for every method.
    """
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan


def _psnr(pair: Pair, where: Bool[np.ndarray, "h w"]) -> float:
    return psnr_of_mse(mean_over((pair.image - pair.target) ** 2, where))


def _inside(pair: Pair, where: Bool[np.ndarray, "h w"]) -> float:
    """SSIM without padding over `where`: only windows that lie inside the image count."""
    inside = windows_valid(np.ones_like(where), WINDOW, beyond_border=False)
    return mean_over(ssim_map(pair.image, pair.target), where & inside)


def _contrast(pair: Pair, where: Bool[np.ndarray, "h w"]) -> float:
    """SSIM's contrast term over `where`, of windows that lie inside the image."""
    inside = windows_valid(np.ones_like(where), WINDOW, beyond_border=False)
    return mean_over(contrast_map(pair.image, pair.target), where & inside)


OVER: dict[str, Callable[[Pair, Bool[np.ndarray, "h w"]], float]] = {
    "psnr": _psnr,
    "ssim_3dgs": lambda pair, where: mean_over(ssim_map(pair.image, pair.target), where),
    "ssim_valid": _inside,
    "ssim_contrast": _contrast,
    "ssim_skimage": lambda pair, where: mean_over(skimage_map(pair), where),
    "ssim_kornia": lambda pair, where: mean_over(kornia_map(pair), where),
    "flip": lambda pair, where: mean_over(flip_map(pair), where),
    "l1": lambda pair, where: mean_over(np.abs(pair.image - pair.target), where),
    "delta_e_76": lambda pair, where: mean_over(delta_e_76_map(pair), where),
    "delta_e_2000": lambda pair, where: mean_over(delta_e_2000_map(pair), where),
    "gradient_l1": lambda pair, where: mean_over(gradient_map(pair), where),
}
"""Metrics that have a value at each pixel: those of a protocol that are scored over parts."""
