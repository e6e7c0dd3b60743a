"""The error of a rendered disparity with its gradient written by hand: twin of the reference's `disparity_error`."""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.supervision.depth_constraint import QUANTILES, quantiles


def disparity_error(
    disparity: Float[Tensor, "h w"],
    target: Float[Tensor, "h w"],
    valid: Bool[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
) -> Float[Tensor, ""]:
    """Mean over all pixels of w |D - D_r|, D brought to the range of the target.

    Twin of splatproof.reference.supervision.depth_constraint.disparity_error: the same operations without a graph of
    them.

    Args:
        disparity: D_ng or D_va; it alone gets a gradient.
        target: D_r, from `normalise_disparity` with the same valid pixels.
        valid: Pixels where D_r is known.
        weight: w in [0, 1], from `appearance_weight`.

    Source: DLG-GS, Eq. 4.
    """
    return _Error.apply(disparity, target, valid, weight)  # type: ignore[return-value]


class _Error(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, disparity: Tensor, target: Tensor, valid: Tensor, weight: Tensor):
        known = disparity.flatten() if valid.all() else disparity[valid]
        low, high = quantiles(known, QUANTILES) if len(known) else (disparity.new_zeros(()),) * 2
        spread = high - low
        ctx.gradient = None
        if not spread > 0:  # a constant map is 0 everywhere, and so is its gradient
            return (weight * target.abs()).mean()
        off = torch.where(valid, (disparity - low) / spread, 0).sub_(target)
        if ctx.needs_input_grad[0]:
            ctx.gradient = off.sign().mul_(weight).div_(spread * weight.numel())  # 0 where unknown
        return off.abs_().mul_(weight).mean()

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        by = None if ctx.gradient is None else ctx.gradient * grad_outputs[0]
        return by, None, None, None
