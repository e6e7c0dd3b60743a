"""Local support network: anchors exchange features, weighted by direction and shape."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.reference.anchors import sparse_convolution
from splatproof.reference.rasterizer import rotation
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp


@dataclass(frozen=True, kw_only=True, eq=False)
class SupportNetwork:
    """Parameters of the inter-anchor consistency step, for c feature channels."""

    convolution: Float[Tensor, "27 c c"]
    modulation: Mlp
    """MLP_gamma: 4 numbers (alignment, three eigenvalue shares) to c."""
    residual: Mlp
    """Linear layer of the residual that is added to the features, c to c."""
    gate: Mlp
    """MLP_g: how much of the residual is added; c to 1, before the sigmoid."""


def create(channels: int, generator: torch.Generator, dtype: torch.dtype) -> SupportNetwork:
    """A network that starts near the identity: its residual layer starts at zero.

    Args:
        channels: Number c of feature channels.
        generator: Source of the random weights.
        dtype: Dtype of the parameters.
    """
    spread = (27 * channels) ** -0.5
    weights = torch.randn(27, channels, channels, generator=generator).to(dtype) * spread
    return SupportNetwork(
        convolution=weights,
        modulation=mlp.create((4, 16, channels), generator, dtype),
        residual=mlp.change(mlp.create((channels, channels), generator, dtype), torch.zeros_like),
        gate=mlp.create((channels, 16, 1), generator, dtype),
    )


def alignment(
    centres: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    around: Int[Tensor, "n 27"],
) -> Float[Tensor, "n 27"]:
    """How well each neighbour lies along the anchor's principal axis: cos^2 theta (1 - l2 / l1).

    The covariance is R diag(s^2) R^T, so the axis of its largest eigenvalue is the column of R
    with the largest scale. The square drops the axis' sign, and the factor fades the direction
    out where the largest eigenvalue is not unique, so that a sphere or a disc gives 0 whichever
    axis is named first (both ours; the paper takes cos theta as it is). 0 for the anchor itself.

    Args:
        centres: Anchor positions in the world, scene units.
        quaternions: Orientation (w, x, y, z) of each anchor's base covariance, any norm.
        scales: Standard deviations of the base covariance in scene units, > 0.
        around: Index of each anchor's 27 neighbours, -1 for none, from
            `sparse_convolution.neighbours`.

    Returns: In [0, 1]; 0 where there is no neighbour.

    Source: HDGS, Sec. 3.3.
    """
    largest = scales.argmax(dim=1)
    axes = rotation.rotation_matrix(quaternions)[torch.arange(len(scales)), :, largest]
    offset = centres[around.clamp(min=0)] - centres[:, None]
    apart = offset.square().sum(dim=-1)
    elsewhere = (around >= 0) & (apart > 0)
    cosine2 = torch.einsum("noi,ni->no", offset, axes).square() / torch.where(elsewhere, apart, 1)
    ordered = scales.square().sort(dim=1, descending=True).values
    unique = 1 - ordered[:, 1] / ordered[:, 0]
    return torch.where(elsewhere, cosine2, 0) * unique[:, None]


def support(
    network: SupportNetwork,
    features: Float[Tensor, "n c"],
    centres: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    voxel: float,
) -> Float[Tensor, "n c"]:
    """f_new = f + g(f_mod) Linear(f_mod), f_mod = sum_j MLP_gamma(cos theta_j, lambda) W_j f_j.

    The eigenvalues enter as shares of their sum, largest first, so that the unit of length does
    not matter (ours).

    Args:
        network: Parameters of the step.
        features: Features f of the anchors, one row each.
        centres: Anchor positions in the world, scene units; at most one anchor a voxel.
        quaternions: Orientation (w, x, y, z) of each anchor's base covariance, any norm.
        scales: Standard deviations of the base covariance in scene units, > 0.
        voxel: Edge of the grid's cells, scene units.

    Source: HDGS, Eqs. 7 and 8.
    """
    around = sparse_convolution.neighbours(sparse_convolution.voxelise(centres, voxel))
    values = scales.square().sort(dim=1, descending=True).values
    shares = values / values.sum(dim=1, keepdim=True)
    along = alignment(centres, quaternions, scales, around)
    code = torch.cat([along[..., None], shares[:, None].expand(-1, 27, 3)], dim=-1)
    weight = mlp.evaluate(network.modulation, code.reshape(-1, 4)).reshape(
        *along.shape, features.shape[1]
    )
    added = sparse_convolution.contributions(features, around, network.convolution)
    modulated = (weight * added).sum(dim=1)
    gate = torch.sigmoid(mlp.evaluate(network.gate, modulated))
    return features + gate * mlp.evaluate(network.residual, modulated)
