"""Rendered disparities with the gradient of an inverse distance written by hand: twins of the reference's two."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.reference.supervision.depth_constraint import ANCHOR_OPACITY, Depth, Rasterizer
from splatproof.reference.types.camera import Camera, transform_points


def gaussian_disparity(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    depth: Depth,
    rasterizer: Rasterizer,
) -> Float[Tensor, "h w"]:
    """D_ng = sum w_i / delta_i, delta = |u_i - x_c|; gradients reach position and opacity only.

    Twin of splatproof.reference.supervision.depth_constraint.gaussian_disparity: it differs by rounding only.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        means: World positions u_i of the Gaussians, scene units.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.
        opacities: Opacity of each Gaussian, in [0, 1].
        depth: What delta_i is: |u_i - x_c| or z.
        rasterizer: What draws it, with the signature of the reference's `rasterize`.

    Returns: Blended inverse of delta, one over scene units.

    Source: DLG-GS, Eqs. 1 and 2, with 1 / delta for delta.
    """
    carried = inverses(camera, means, depth)
    fixed = quaternions.detach(), scales.detach()
    drawn = rasterizer(camera, means, *fixed, opacities, colours=carried[:, None])
    return drawn.colour.squeeze(dim=2)


def anchor_disparity(
    camera: Camera,
    anchors: Float[Tensor, "a 3"],
    rows: Int[Tensor, " n"],
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    *,
    depth: Depth,
    rasterizer: Rasterizer,
) -> Float[Tensor, "h w"]:
    """D_va: as D_ng with the anchors' distances and tau G(p), tau = 0.95; gradients reach anchors.

    Twin of splatproof.reference.supervision.depth_constraint.anchor_disparity, which is given an anchor for each
    Gaussian: here a distance is computed once an anchor. It differs by rounding only.

    Args:
        camera: The pinhole camera, from whose centre distances are taken.
        anchors: Positions of all anchors, scene units.
        rows: Which anchor generated each Gaussian.
        means: World positions of the Gaussians, scene units; no gradient flows to them.
        quaternions: (w, x, y, z), any norm; no gradient flows to them.
        scales: Standard deviations in scene units, >= 0; no gradient flows to them.
        depth: What an anchor's distance is: to the camera's centre, or z.
        rasterizer: What draws it, with the signature of the reference's `rasterize`.

    Source: DLG-GS, Eq. 3, with 1 / delta for delta; once an anchor: ours.
    """
    carried = inverses(camera, anchors, depth).index_select(0, rows)
    opacities = torch.full_like(carried, ANCHOR_OPACITY).detach()
    fixed = means.detach(), quaternions.detach(), scales.detach()
    drawn = rasterizer(camera, *fixed, opacities, colours=carried[:, None])
    return drawn.colour.squeeze(dim=2)


def inverses(camera: Camera, positions: Float[Tensor, "n 3"], depth: Depth) -> Float[Tensor, " n"]:
    """1 / |x - x_c| or 1 / z; what is nearer than the near plane counts as on it.

    Args:
        camera: The pinhole camera, whose near plane is in front of its centre.
        positions: World positions x, scene units.
        depth: "distance" or "z".
    """
    if depth == "z":
        return 1 / transform_points(camera, positions)[:, 2].clamp(min=camera.near)
    return _Inverse.apply(positions, camera.centre.to(positions), camera.near)


class _Inverse(torch.autograd.Function):
    """The gradient of 1 / |d| is -d / |d|^3: autograd takes it apart into norm, bound and inverse."""

    @staticmethod
    def forward(ctx: Any, positions: Tensor, centre: Tensor, near: float):
        offset = positions - centre
        far = offset.norm(dim=1)
        inverse = far.clamp(min=near).reciprocal_()
        ctx.save_for_backward(offset, far, inverse)
        ctx.near = near
        return inverse

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        offset, far, inverse = ctx.saved_tensors
        factor = (inverse * inverse).mul_(inverse).mul_(grad_outputs[0]).neg_()
        factor.masked_fill_(far < ctx.near, 0)  # on the near plane, wherever it moves
        return offset * factor[:, None], None, None
