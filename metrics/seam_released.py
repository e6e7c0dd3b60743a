"""Seam metrics as the StitchGS authors' released code is understood to compute them.

Other quantities than the paper's (see metrics.seam), under names that say so: the definition is
inferred from the release. Each view has its value; a scene's is the mean over the views that do.
"""

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.metrics.pairs import check_pair
from splatproof.metrics.pixel import l1, psnr
from splatproof.metrics.seam import SeamScores, overlap_band
from splatproof.reference.partition.boxes import OrientedBox, box_distance, widen_oriented
from splatproof.reference.types.camera import Camera

MARGIN = 0.15
"""The release's expand_ratio: boxes are widened by this before distances are taken."""
LUMA = (0.299, 0.587, 0.114)
"""Weights of R, G and B in luminance (ITU-R BT.601); our choice."""
NAMES: tuple[str, ...] = (
    "seam_psnr_released",
    "seam_l1_released",
    "seam_gradient_ratio_released",
    "seam_depth_gradient_ratio_released",
)


def seam_mask_released(
    depth: Float[Tensor, "h w"],
    camera: Camera,
    boxes: Sequence[OrientedBox],
    *,
    margin: float = MARGIN,
) -> Bool[Tensor, "h w"]:
    """Pixels whose surface point lies at distance (1.0, 1.1] of ANY margin-widened box.

    Args:
        depth: z-depth in scene units, rendered or of a monocular prior; not > 0 or not finite:
            nothing is there and the pixel is no seam.
        camera: Camera that saw the depth.
        boxes: The blocks' boxes before the margin.
        margin: Share by which half-extents grow.
    """
    seen = depth.isfinite() & (depth > 0)
    points = back_project(torch.where(seen, depth, 1.0), camera).reshape(-1, 3)
    near = torch.zeros(len(points), dtype=torch.bool)
    for box in boxes:
        near |= overlap_band(box_distance(widen_oriented(box, margin), points))
    return near.reshape(depth.shape) & seen


def back_project(depth: Float[Tensor, "h w"], camera: Camera) -> Float[Tensor, "h w 3"]:
    """World points of pixel centres: R^T (z K^-1 (i + 0.5, j + 0.5, 1) - t); float64.

    Args:
        depth: z-depth of each pixel in scene units.
        camera: Camera that saw the depth.
    """
    height, width = depth.shape
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([columns + 0.5, rows + 0.5, torch.ones(height, width)], dim=2).double()
    rays = pixels @ torch.linalg.inv(camera.K.double()).T
    local = depth.double()[..., None] * rays
    return (local - camera.translation.double()) @ camera.rotation.double()


def seam_view_released(
    image: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "h w 3"],
    depth: Float[Tensor, "h w"],
    seam: Bool[Tensor, "h w"],
    mask: Bool[Tensor, "h w"] | None = None,
) -> SeamScores:
    """The released family on one view.

    seam_psnr_released is the PSNR over seam pixels and channels; seam_l1_released the mean
    absolute difference of render and TRUTH there; seam_gradient_ratio_released the mean Sobel
    magnitude of the render's luminance on the seam over that off it (so about 1 without a
    visible seam), and seam_depth_gradient_ratio_released the same of the rendered depth.

    Args:
        image: The render, in [0, 1].
        truth: What the camera saw, in [0, 1].
        depth: The rendered depth in scene units.
        seam: True where a pixel is on the seam, from `seam_mask_released`.
        mask: True where a pixel counts, on the seam or off it; None: everywhere.
    Raises: DataError where an image is not in [0, 1] or a depth not finite.
    """
    if not bool(depth.isfinite().all()):
        raise DataError("seam metrics: depth holds values that are not finite")
    luminance = (check_pair(image, image, metric=NAMES[2]).image * LUMA).sum(axis=2)
    counted = torch.ones_like(seam) if mask is None else mask
    seam = seam & counted
    on, off = seam.numpy(), (counted & ~seam).numpy()
    if not on.any():
        why = f"the seam mask is empty in all {on.size} pixels"
        return SeamScores(
            values=dict.fromkeys(NAMES, math.nan), undefined=dict.fromkeys(NAMES, why)
        )
    values = {NAMES[0]: psnr(image, truth, seam), NAMES[1]: l1(image, truth, seam)}
    undefined = {}
    for name, field in ((NAMES[2], luminance), (NAMES[3], depth.double().numpy())):
        slope = sobel_magnitude(field)
        outside = float(slope[off].mean()) if off.any() else math.nan
        values[name] = float(slope[on].mean()) / outside if outside > 0 else math.nan
        if not outside > 0:
            undefined[name] = "no pixel or no gradient off the seam to compare with"
    return SeamScores(values=values, undefined=undefined)


def sobel_magnitude(field: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """sqrt(gx^2 + gy^2) of the 3x3 Sobel filters, borders repeated."""
    gx, gy = (
        cv2.Sobel(field, cv2.CV_64F, dx, 1 - dx, ksize=3, borderType=cv2.BORDER_REPLICATE)
        for dx in (1, 0)
    )
    return np.hypot(gx, gy)


def seam_scores_released(views: Iterable[SeamScores]) -> SeamScores:
    """Mean of each metric over the views in which it is defined."""
    every = list(views)
    values, undefined = {}, {}
    for name in NAMES:
        defined = [view.values[name] for view in every if name not in view.undefined]
        values[name] = math.fsum(defined) / len(defined) if defined else math.nan
        if not defined:
            undefined[name] = f"defined in none of {len(every)} views"
    return SeamScores(values=values, undefined=undefined)
