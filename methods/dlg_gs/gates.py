"""What attention reads of an anchor, and its gated projections, in fewer passes: twins of the reference's."""

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.reference.anchors.attention import OCTAVES, AttentionWeights

CODE = 6 * OCTAVES
"""Numbers of the Fourier code: sine and cosine of three coordinates an octave."""


def attention_inputs(
    centres: Float[Tensor, "n 3"],
    low: Float[Tensor, "3"],
    high: Float[Tensor, "3"],
    camera_centre: Float[Tensor, "3"],
    extent: float,
) -> Float[Tensor, "n d"]:
    """Fourier code of where an anchor stands in the box, direction to it, distance in extents.

    Twin of splatproof.reference.anchors.attention.fourier_code behind its `in_box`, and of
    splatproof.reference.anchors.scaffold.view_code. Each octave is made of the one before, sin 2a = 2 sin a cos a and
    cos 2a = 1 - 2 sin^2 a, which is off by what rounding of the largest argument, 16 pi, does to the reference as well.

    Args:
        centres: Anchor positions, scene units; those outside the box count as on its side. No gradient.
        low: Corner of the scene's box with the smallest coordinates, scene units.
        high: The opposite corner.
        camera_centre: Centre of the camera in the world, scene units.
        extent: Unit of the distance, in scene units.

    Returns: A row an anchor, whose columns lie side by side in memory: sines, sums over anchors and products with
        weights run along them.

    Raises: ValueError if the box has no extent along an axis.

    Source: DLG-GS, Eq. 6.
    """
    if not (high > low).all():
        raise ValueError(f"box without extent: from {low.tolist()} to {high.tolist()}")
    columns = centres.detach().T.contiguous()
    made = columns.new_empty(CODE + 4, len(centres))
    low, high = low[:, None], high[:, None]
    share = ((columns - low) / (high - low)).clamp_(0, 1 - torch.finfo(centres.dtype).eps)
    angle = share.mul_(2 * math.pi)
    sine, cosine = angle.sin(), angle.cos()
    for octave in range(OCTAVES):
        first, second = made[6 * octave : 6 * octave + 6].split(3)
        if octave % 2:  # the phase of pi / 2
            first.copy_(cosine)
            torch.neg(sine, out=second)
        else:
            first.copy_(sine)
            second.copy_(cosine)
        sine, cosine = (2 * sine).mul_(cosine), (sine * sine).mul_(-2).add_(1)
    offset = columns - camera_centre.to(columns)[:, None]
    distance = offset.square().sum(dim=0).sqrt_()
    torch.div(offset, torch.where(distance > 0, distance, 1), out=made[CODE : CODE + 3])
    torch.div(distance, extent, out=made[CODE + 3])
    return made.T


def gated_projections(
    inputs: Float[Tensor, "n d"], weights: AttentionWeights
) -> tuple[Float[Tensor, "n dk"], Float[Tensor, "n dk"], Float[Tensor, "n dv"]]:
    """Query over sqrt(d_k), key and value of the gated inputs: (x z_h z_w) W = (x z_h) (z_w W).

    Twin of splatproof.reference.anchors.attention.pooled_gates and the three products with what it returns. The gate of
    a feature goes to the rows of W, of which there are few, as does the scale of the scores; and as inputs have no gradient, that of an anchor's gate is
    what products with the projections themselves sum to.

    Args:
        inputs: Attention inputs x of each anchor, without gradient.
        weights: Kernels and projections.

    Raises: ValueError if the inputs require a gradient.

    Source: DLG-GS, Eqs. 8 to 10; the order of the products: ours.
    """
    if inputs.requires_grad:
        raise ValueError("inputs require a gradient, but get none; detach them")
    anchor, feature = (
        functional.conv1d(
            inputs.mean(dim=axis)[None, None], kernel[None, None], padding=len(kernel) // 2
        )[0, 0]
        for axis, kernel in ((1, weights.anchor_kernel), (0, weights.feature_kernel))
    )
    gate = torch.sigmoid(feature)[:, None]
    query = weights.query / math.sqrt(weights.key.shape[1])
    projections = (gate * each for each in (query, weights.key, weights.value))
    return _Projected.apply(inputs, anchor, *projections)


class _Projected(torch.autograd.Function):
    """(x sigmoid(h)) W for some W; h and each W get gradients."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, logits: Tensor, *projections: Tensor):
        gate = logits.sigmoid()
        gated = inputs * gate[:, None]
        made = tuple(gated @ each for each in projections)
        ctx.save_for_backward(gated, gate, *made)
        return made

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        gated, gate, *made = ctx.saved_tensors
        # a factor on the gate is one on all that the anchor's inputs become
        first, *others = zip(grad_outputs, made, strict=True)
        moved = first[0] * first[1]
        for by, of in others:
            moved.addcmul_(by, of)
        by_logits = moved.sum(dim=1).mul_(1 - gate)
        return None, by_logits, *(gated.T @ by for by in grad_outputs)
