"""Voxel-depth joint constraint (VDJC): Gaussians and their anchors against a relative depth."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera

ANCHOR_OPACITY = 0.95
"""tau: fixed opacity of the anchor-level render."""
QUANTILES = (0.02, 0.98)


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthWeights:
    """lambda_EC and lambda_MC. Source: DLG-GS, Sec. 3.2."""

    gaussian: float = 0.01
    anchor: float = 0.01


def _blend(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    carried: Float[Tensor, " n"],
) -> Float[Tensor, "h w"]:
    """Sum of w_i d_i over each pixel; not divided by the weights."""
    return rasterize(
        camera, means, quaternions, scales, opacities, colours=carried[:, None]
    ).colour[..., 0]


def gaussian_depth(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
) -> Float[Tensor, "h w"]:
    """D_ng = sum delta_i w_i, delta = |u_i - x_c|; gradients reach position and opacity only.

    Not normalised by the weights (as the paper prints it): a pixel that nothing covers has 0.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        means: World positions u_i of the Gaussians, scene units.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.
        opacities: Opacity of each Gaussian, in [0, 1].

    Returns: Blended distance to the camera centre, scene units.

    Source: DLG-GS, Eqs. 1 and 2.
    """
    distances = (means - camera.centre.to(means)).norm(dim=1)
    return _blend(camera, means, quaternions.detach(), scales.detach(), opacities, distances)


def anchor_depth(
    camera: Camera,
    anchors: Float[Tensor, "n 3"],
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
) -> Float[Tensor, "h w"]:
    """D_va: the anchors' distances blended with tau G(p), tau = 0.95; gradients reach anchors only.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        anchors: For each Gaussian the position of the anchor that generated it, scene units.
        means: World positions of the Gaussians, scene units; no gradient flows to them.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.

    Source: DLG-GS, Eq. 3.
    """
    distances = (anchors - camera.centre.to(anchors)).norm(dim=1)
    opacities = torch.full_like(distances, ANCHOR_OPACITY).detach()
    return _blend(
        camera, means.detach(), quaternions.detach(), scales.detach(), opacities, distances
    )


def normalise_depth(
    depth: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"]
) -> Float[Tensor, "h w"]:
    """Robust affine map: the 2 % quantile of the valid pixels to 0, the 98 % quantile to 1.

    No gradient flows through the quantiles. A map that is constant, or has no valid pixel, maps
    to 0; so do invalid pixels (also where they are inf or NaN).

    Args:
        depth: Depth in any unit.
        valid: Pixels whose depth is known; only these set the range.

    Source: ours (the paper: "normalized to a comparable range").
    """
    clean = torch.where(valid, depth, 0)
    if not valid.any():
        return clean
    low, high = torch.quantile(depth[valid].detach(), depth.new_tensor(QUANTILES))
    spread = high - low
    if not spread > 0:
        return torch.where(valid, clean * 0, 0)
    return torch.where(valid, (clean - low) / spread, 0)


def from_disparity(disparity: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """Depth 1 / d of a monocular disparity; inf where it is not positive (mask those out)."""
    return torch.where(disparity > 0, 1 / torch.where(disparity > 0, disparity, 1), torch.inf)


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
        gaussian: D_ng, from `gaussian_depth`.
        anchor: D_va, from `anchor_depth`.
        reference: Monocular depth D_r (not disparity), relative only.
        valid: Pixels where D_r is known.
        weight: w in [0, 1], from `appearance_weight`.
        strength: Factors l_EC and l_MC of the two terms.

    Source: DLG-GS, Eqs. 4 and 5.
    """
    target = normalise_depth(reference, valid)
    terms = [
        (weight * (normalise_depth(depth, valid) - target).abs()).mean()
        for depth in (gaussian, anchor)
    ]
    return strength.gaussian * terms[0] + strength.anchor * terms[1]
