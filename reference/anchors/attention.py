"""Local multi-granularity attention between anchors: pooled gates, then masked self-attention."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

OCTAVES = 4
"""K, the number of frequencies in the Fourier code."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AttentionWeights:
    """Learnt parameters, for d input numbers (28 in the paper) and d_k numbers of query and key."""

    anchor_kernel: Float[Tensor, " a"]
    """1D convolution over the pooled value of each anchor, odd length."""
    feature_kernel: Float[Tensor, " b"]
    """1D convolution over the pooled value of each feature, odd length."""
    query: Float[Tensor, "d dk"]
    key: Float[Tensor, "d dk"]
    value: Float[Tensor, "d dv"]


def create(
    inputs: int, width: int, generator: torch.Generator, dtype: torch.dtype = torch.float32
) -> AttentionWeights:
    """Random projections, and gates that start as plain smoothing.

    Args:
        inputs: Number d of input features an anchor (28 in the paper).
        width: Number of columns of query, key and value: d_k = d_v.
        generator: Source of the random projections.
        dtype: Dtype of the parameters.
    """

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator).to(dtype) * inputs**-0.5

    return AttentionWeights(
        anchor_kernel=torch.ones(1, dtype=dtype), feature_kernel=torch.ones(3, dtype=dtype) / 3,
        query=draw(inputs, width), key=draw(inputs, width), value=draw(inputs, width),
    )  # fmt: skip


def in_box(
    centres: Float[Tensor, "n 3"], low: Float[Tensor, "3"], high: Float[Tensor, "3"]
) -> Float[Tensor, "n 3"]:
    """Share of the way through the scene's box along each axis, in [0, 1): what the code reads.

    Args:
        centres: Anchor positions, scene units; those outside the box count as on its side.
        low: Corner of the box with the smallest coordinates, scene units.
        high: The opposite corner.

    Raises: ValueError if the box has no extent along an axis.

    Source: ours.
    """
    if not (high > low).all():
        raise ValueError(f"box without extent: from {low.tolist()} to {high.tolist()}")
    return ((centres - low) / (high - low)).clamp(0, 1 - torch.finfo(centres.dtype).eps)


def fourier_code(centres: Float[Tensor, "n 3"]) -> Float[Tensor, "n 24"]:
    """eps_a: sin and cos of 2 pi w_k x + phi_k, w_k = 2^(k-1), phi_k = 0, pi/2, 0, pi/2.

    The code has period 1, so no two places of [0, 1) share one; only its two ends meet.

    Args:
        centres: Anchor positions in [0, 1), from `in_box`.

    Returns: For each octave sin x 3 then cos x 3.

    Raises: ValueError if a position is outside [0, 1), where it would alias.

    Source: DLG-GS, Eq. 6; frequencies and phases as the spec decides.
    """
    if not ((centres >= 0) & (centres < 1)).all():
        raise ValueError("the code has period 1: scale positions to [0, 1), see in_box")
    octaves = torch.arange(OCTAVES).to(centres)[:, None]
    argument = 2 * math.pi * 2**octaves * centres[:, None] + octaves % 2 * math.pi / 2
    return torch.stack([torch.sin(argument), torch.cos(argument)], dim=2).flatten(1)


def pooled_gates(inputs: Float[Tensor, "n d"], weights: AttentionWeights) -> Float[Tensor, "n d"]:
    """f_gra = x * z_h * z_w, z = sigmoid(conv1d(mean over the other axis)).

    Anchors have no natural order, so a kernel longer than one over the anchor axis would make the
    result depend on it: the anchor kernel has length 1 unless set otherwise (our decision).

    Args:
        inputs: Attention inputs x of each anchor: Fourier code, view direction, distance.
        weights: The two kernels are read.

    Returns: The inputs, each one times two gates in (0, 1): its anchor's and its feature's.

    Source: DLG-GS, Eq. 8.
    """
    gates = []
    for axis, kernel in ((1, weights.anchor_kernel), (0, weights.feature_kernel)):
        pooled = inputs.mean(dim=axis)
        mixed = functional.conv1d(pooled[None, None], kernel[None, None], padding=len(kernel) // 2)
        gates.append(torch.sigmoid(mixed[0, 0]))
    return inputs * gates[0][:, None] * gates[1][None]


def local_attention(
    features: Float[Tensor, "n d"],
    centres: Float[Tensor, "n 3"],
    radius: float,
    weights: AttentionWeights,
) -> Float[Tensor, "n dv"]:
    """Softmax(Q K^T / sqrt(d_k) + M) V; M is 0 within the radius and -inf beyond.

    An anchor always sees itself, so no row is empty. The dense form, in O(n^2).

    Args:
        features: Gated inputs, from `pooled_gates`.
        centres: Anchor positions, in the unit of the radius.
        radius: r >= 0; anchors at exactly r are seen.
        weights: The three projections are read.

    Raises: ValueError if the radius is negative.

    Source: DLG-GS, Eqs. 9 to 11.
    """
    if not radius >= 0:
        raise ValueError(f"radius must not be negative: {radius}")
    query, key, value = (features @ w for w in (weights.query, weights.key, weights.value))
    apart = (centres[:, None] - centres[None]).norm(dim=-1)
    seen = (apart <= radius) | torch.eye(len(centres), dtype=torch.bool)
    scores = query @ key.T / math.sqrt(key.shape[1])
    return torch.softmax(torch.where(seen, scores, -torch.inf), dim=1) @ value
