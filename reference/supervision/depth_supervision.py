"""Local depth supervision, LiDAR and sky terms of a driving scene."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

ALPHA_FLOOR = 1e-6
"""Alpha is kept this far from 0 and 1 inside logarithms."""


def edge_weight(image: Float[Tensor, "h w 3"], beta: float) -> Float[Tensor, "h w"]:
    """w = exp(-beta |Sobel(I)|_2) in (0, 1]: small where the image has an edge.

    The 3 x 3 Sobel kernels are divided by 8, so a ramp of slope s has |Sobel| = s a channel; the
    norm runs over both directions and all channels; borders repeat. (The paper leaves both open.)

    Args:
        image: Photo, sRGB in [0, 1].
        beta: How fast the weight falls with the strength of an edge, >= 0; 0 gives 1 everywhere.

    Source: HDGS, Eq. 12.
    """
    across = torch.tensor([[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]]).to(image) / 8
    kernels = torch.stack([across, across.T])[:, None]
    planes = functional.pad(image.permute(2, 0, 1)[:, None], (1, 1, 1, 1), mode="replicate")
    return torch.exp(-beta * functional.conv2d(planes, kernels).square().sum(dim=(0, 1)).sqrt())


def smoothness_loss(
    depth: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"], beta: float
) -> Float[Tensor, ""]:
    """L_sm = 1/N sum w (|dz/dx| + |dz/dy|) with forward differences, zero past the border.

    Args:
        depth: Rendered depth z, any unit; the loss has the same.
        image: Photo, sRGB in [0, 1], whose edges may be edges of depth.
        beta: How fast the weight falls with the strength of an edge, see `edge_weight`.

    Source: HDGS, Eq. 12.
    """
    step_x = functional.pad((depth[:, 1:] - depth[:, :-1]).abs(), (0, 1))
    step_y = functional.pad((depth[1:] - depth[:-1]).abs(), (0, 0, 0, 1))
    return (edge_weight(image, beta) * (step_x + step_y)).mean()


def outlier_loss(
    ranks: Float[Tensor, "h w"],
    image: Float[Tensor, "h w 3"],
    beta: float,
    delta: float,
    radius: int = 1,
) -> Float[Tensor, ""]:
    """L_out = 1/N sum w 1(e > delta) e, e = |rank - mean rank of the neighbourhood|.

    `soft_rank` of a whole image keeps a table of n x n numbers for its gradient: 58 GB at 120,000
    pixels in float32. Until there is a twin that ranks whole images, this is for small crops.

    Args:
        ranks: Soft ranks of the rendered depth, divided by the number of pixels so that delta does
            not depend on the image size (ours).
        image: Photo, sRGB in [0, 1], whose edges may be edges of depth.
        beta: How fast the weight falls with the strength of an edge, see `edge_weight`.
        delta: Threshold on e, in the unit of the ranks.
        radius: The neighbourhood is (2 radius + 1)^2 pixels, the pixel itself included, clipped at
            the border.

    Source: HDGS, Eq. 13.
    """
    side = 2 * radius + 1
    mean = functional.avg_pool2d(
        ranks[None, None], side, stride=1, padding=radius, count_include_pad=False
    )[0, 0]
    off = (ranks - mean).abs()
    return (edge_weight(image, beta) * torch.where(off > delta, off, 0)).mean()


def lidar_loss(
    depth: Float[Tensor, "h w"], lidar: Float[Tensor, "h w"], hit: Bool[Tensor, "h w"]
) -> Float[Tensor, ""]:
    """Mean |z_rendered - z_lidar| over the pixels that the LiDAR hit; 0 where it hit none.

    Args:
        depth: Rendered z-depth, scene units.
        lidar: Measured z-depth, scene units; only read where the LiDAR hit.
        hit: Pixels that the LiDAR hit.

    Source: HDGS, Sec. 3.6 (L1, as in the spec).
    """
    off = torch.where(hit, depth - torch.where(hit, lidar, 0), 0).abs().sum()
    return off / hit.sum().clamp(min=1)


def sky_loss(alpha: Float[Tensor, "h w"], sky: Bool[Tensor, "h w"]) -> Float[Tensor, ""]:
    """Binary cross-entropy that wants alpha 0 in the sky and 1 elsewhere, mean over pixels; 0 without any.

    Args:
        alpha: Rendered opacity of each pixel, 1 - transmittance, in [0, 1].
        sky: Pixels that show the sky.

    Source: HDGS, Sec. 3.6.
    """
    if not alpha.numel():
        return alpha.new_zeros(())
    safe = alpha.clamp(ALPHA_FLOOR, 1 - ALPHA_FLOOR)
    return functional.binary_cross_entropy(safe, (~sky).to(safe))
