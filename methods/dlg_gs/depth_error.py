"""The error of a rendered disparity with its gradient written by hand, and its weight: twins of the reference's."""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.supervision.depth_constraint import QUANTILES


def appearance_weight(
    adapted: Float[Tensor, "h w 3"], original: Float[Tensor, "h w 3"]
) -> Float[Tensor, "h w"]:
    """w = 1 - clip(|I_a - I_r|, 0, 1), mean over channels, without gradient.

    Twin of splatproof.reference.supervision.depth_constraint.appearance_weight: a product for the mean over so short
    rows; it differs by rounding only.

    Args:
        adapted: Render I_a with the colours adapted to the view's light, in [0, 1].
        original: Render I_r with the colours as they are, in [0, 1].

    Source: DLG-GS, Eq. 15.
    """
    apart = (adapted.detach() - original.detach()).abs_()
    thirds = apart.new_full((3,), 1 / 3)
    return (apart @ thirds).clamp_(0, 1).neg_().add_(1)


def disparity_error(
    disparity: Float[Tensor, "h w"],
    target: Float[Tensor, "h w"],
    valid: Bool[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
) -> Float[Tensor, ""]:
    """Mean over all pixels of w |D - D_r|, D brought to the range of the target.

    Twin of splatproof.reference.supervision.depth_constraint.disparity_error: the same without a graph, and with a sum
    of products for the mean; it differs by rounding only.

    Args:
        disparity: D_ng or D_va; it alone gets a gradient.
        target: D_r, from `normalise_disparity` with the same valid pixels.
        valid: Pixels where D_r is known.
        weight: w in [0, 1], from `appearance_weight`.

    Source: DLG-GS, Eq. 4.
    """
    return _Error.apply(disparity, target, valid, weight)


class _Error(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, disparity: Tensor, target: Tensor, valid: Tensor, weight: Tensor):
        known = disparity.flatten() if valid.all() else disparity.masked_select(valid)
        low, high = _ends(known) if len(known) else (disparity.new_zeros(()),) * 2
        spread = high - low
        ctx.gradient = None
        if not spread > 0:  # a constant map is 0 everywhere, and so is its gradient
            return (weight * target.abs()).mean()
        off = torch.where(valid, disparity, low).sub_(low).div_(spread).sub_(target)
        pulls = off.sign().mul_(weight)  # 0 where unknown
        if ctx.needs_input_grad[0]:
            ctx.gradient, ctx.scale = pulls, 1 / (spread * off.numel())
        return torch.dot(pulls.flatten(), off.flatten()) / off.numel()

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        by = None if ctx.gradient is None else ctx.gradient * (grad_outputs[0] * ctx.scale)
        return by, None, None, None


def _ends(values: Tensor) -> list[Tensor]:
    """The two QUANTILES, to the bit as the reference's `quantiles` has them.

    One after the other: numpy finds several ranks at once without vectors, more slowly.
    """
    left, found = values.cpu().numpy().copy(), []
    for share in QUANTILES:
        rank = share * (len(values) - 1)
        below = math.floor(rank)
        left.partition(below)
        above = np.fmin.reduce(left[below + 1 :]) if below < rank else left[below]
        here, there = values.new_tensor([float(left[below]), float(above)])
        found.append(here.lerp(there, rank - below))
    return found
