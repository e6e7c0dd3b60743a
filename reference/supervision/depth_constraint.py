"""Voxel-depth joint constraint (VDJC): Gaussians and their anchors against a relative disparity.

The paper blends distances and compares them with what a monocular network says. Such a network says
a d + b of the disparity d, with a and b unknown: no inverse of that is affine in depth. So here both
renders blend inverses, in which what nothing covers is infinitely far instead of at the camera (ours).

A disparity is 1 / z, z along the optical axis. The paper prints distances to the camera's centre, and
does not say which the network's are. They differ by the cosine of a pixel's angle to the axis, which
no affine map takes away: under depth "z" true geometry has no error against a true disparity, under
"distance", as printed, it has one that grows with the field of view.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera, transform_points
from splatproof.reference.types.render import RenderOutput

ANCHOR_OPACITY = 0.95
"""tau: fixed opacity of the anchor-level render."""
QUANTILES = (0.02, 0.98)
Depth = Literal["distance", "z"]
"""How far a position is: |x - x_c|, as the paper prints it, or along the optical axis, as a disparity."""
Rasterizer = Callable[..., RenderOutput]
"""Anything with the signature and meaning of the reference's `rasterize`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthWeights:
    """lambda_EC, lambda_MC and the rate that lets the second act. Source: DLG-GS, Sec. 3.2."""

    gaussian: float = 0.01
    anchor: float = 0.01
    anchor_rate: float = 1.6e-4
    """Learning rate of the anchors' centres in units of the scene's extent, where this constraint
    is on. The anchor term reaches nothing but centres, and those of Scaffold-GS have rate 0: it
    would have no effect. The paper gives no value; this is 3DGS's first rate of positions."""


def _blend(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    carried: Float[Tensor, " n"],
    rasterizer: Rasterizer,
) -> Float[Tensor, "h w"]:
    """Sum of w_i d_i over each pixel; not divided by the weights."""
    return rasterizer(
        camera, means, quaternions, scales, opacities, colours=carried[:, None]
    ).colour[..., 0]


def _inverses(camera: Camera, positions: Float[Tensor, "n 3"], depth: Depth) -> Float[Tensor, " n"]:
    """1 / |x - x_c| or 1 / z; what is nearer than the near plane counts as on it."""
    if depth == "z":
        far = transform_points(camera, positions)[:, 2]
    else:
        far = (positions - camera.centre.to(positions)).norm(dim=1)
    return 1 / far.clamp(min=camera.near)


def gaussian_disparity(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    depth: Depth = "distance",
    rasterizer: Rasterizer = rasterize,
) -> Float[Tensor, "h w"]:
    """D_ng = sum w_i / delta_i, delta = |u_i - x_c|; gradients reach position and opacity only.

    Not normalised by the weights (as the paper prints it): a pixel that nothing covers has 0.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        means: World positions u_i of the Gaussians, scene units.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.
        opacities: Opacity of each Gaussian, in [0, 1].
        depth: What delta_i is: |u_i - x_c| or z.
        rasterizer: What draws it; a backend's keeps to the same signature.

    Returns: Blended inverse of delta, one over scene units.

    Source: DLG-GS, Eqs. 1 and 2, with 1 / delta for delta.
    """
    carried = _inverses(camera, means, depth)
    fixed = quaternions.detach(), scales.detach()
    return _blend(camera, means, *fixed, opacities, carried, rasterizer)


def anchor_disparity(
    camera: Camera,
    anchors: Float[Tensor, "n 3"],
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    *,
    depth: Depth = "distance",
    rasterizer: Rasterizer = rasterize,
) -> Float[Tensor, "h w"]:
    """D_va: as D_ng with the anchors' distances and tau G(p), tau = 0.95; gradients reach anchors.

    Anchors only: they must have a learning rate, see `DepthWeights.anchor_rate`.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        anchors: For each Gaussian the position of the anchor that generated it, scene units.
        means: World positions of the Gaussians, scene units; no gradient flows to them.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.
        depth: What an anchor's distance is: to the camera's centre, or z.
        rasterizer: What draws it; a backend's keeps to the same signature.

    Source: DLG-GS, Eq. 3, with 1 / delta for delta.
    """
    carried = _inverses(camera, anchors, depth)
    opacities = torch.full_like(carried, ANCHOR_OPACITY).detach()
    fixed = means.detach(), quaternions.detach(), scales.detach()
    return _blend(camera, *fixed, opacities, carried, rasterizer)


def normalise_disparity(
    disparity: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"]
) -> Float[Tensor, "h w"]:
    """Robust affine map: the 2 % quantile of the valid pixels to 0, the 98 % quantile to 1.

    No gradient flows through the quantiles. A map that is constant, or has no valid pixel, maps
    to 0; so do invalid pixels (also where they are inf or NaN).

    Args:
        disparity: Disparity in any unit.
        valid: Pixels whose disparity is known; only these set the range.

    Source: ours (the paper: "normalized to a comparable range").
    """
    clean = torch.where(valid, disparity, 0)
    if not valid.any():
        return clean
    known = disparity[valid].detach()
    low, high = quantiles(known, QUANTILES)
    spread = high - low
    if not spread > 0:
        return torch.where(valid, clean * 0, 0)
    return torch.where(valid, (clean - low) / spread, 0)


def quantiles(values: Float[Tensor, " n"], shares: Sequence[float]) -> list[Float[Tensor, ""]]:
    """Linear between neighbours in order, as torch.quantile, which sorts all values to find them.

    Args:
        values: At least one.
        shares: Each in [0, 1]: 0 is the smallest value, 1 the largest.
    """
    ranks = [share * (len(values) - 1) for share in shares]
    below = [math.floor(rank) for rank in ranks]
    above = [min(rank + 1, len(values) - 1) for rank in below]
    placed = torch.from_numpy(np.partition(values.cpu().numpy(), [*below, *above])).to(values)
    return [
        placed[low].lerp(placed[high], rank - low)
        for rank, low, high in zip(ranks, below, above, strict=True)
    ]


def appearance_weight(
    adapted: Float[Tensor, "h w 3"], original: Float[Tensor, "h w 3"]
) -> Float[Tensor, "h w"]:
    """w = 1 - clip(|I_a - I_r|, 0, 1), mean over channels, without gradient.

    Args:
        adapted: Render I_a with the colours adapted to the view's light, in [0, 1].
        original: Render I_r with the colours as they are, in [0, 1].

    Source: DLG-GS, Eq. 15.
    """
    return 1 - (adapted - original).detach().abs().mean(dim=-1).clamp(0, 1)


def disparity_error(
    disparity: Float[Tensor, "h w"],
    target: Float[Tensor, "h w"],
    valid: Bool[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
) -> Float[Tensor, ""]:
    """Mean over all pixels of w |D - D_r|, D brought to the range of the target.

    Args:
        disparity: D_ng or D_va.
        target: D_r, from `normalise_disparity` with the same valid pixels.
        valid: Pixels where D_r is known.
        weight: w in [0, 1], from `appearance_weight`.

    Source: DLG-GS, Eq. 4.
    """
    return (weight * (normalise_disparity(disparity, valid) - target).abs()).mean()


def depth_loss(
    gaussian: Float[Tensor, "h w"],
    anchor: Float[Tensor, "h w"],
    reference: Float[Tensor, "h w"],
    valid: Bool[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
    strength: DepthWeights,
) -> Float[Tensor, ""]:
    """L_depth = l_EC mean(w |D_ng - D_r|) + l_MC mean(w |D_va - D_r|), each map normalised.

    Args:
        gaussian: D_ng, from `gaussian_disparity`.
        anchor: D_va, from `anchor_disparity`.
        reference: Disparity D_r as a monocular network says it: scale and zero point unknown.
        valid: Pixels where D_r is known.
        weight: w in [0, 1], from `appearance_weight`.
        strength: Factors l_EC and l_MC of the two terms.

    Source: DLG-GS, Eqs. 4 and 5.
    """
    target = normalise_disparity(reference, valid)
    terms = [disparity_error(each, target, valid, weight) for each in (gaussian, anchor)]
    return strength.gaussian * terms[0] + strength.anchor * terms[1]
