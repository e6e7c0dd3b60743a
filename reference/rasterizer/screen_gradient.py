"""Gradients by the 2D means, signed and absolute, that density control is steered by."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class ScreenProbe:
    """Two zero tensors whose .grad, after backward, holds statistics in loss per pixel.

    They are not added to anything: they only collect.
    """

    signed: Float[Tensor, "n 2"]
    """Its .grad is the sum over pixels of d loss / d (2D mean)."""
    absolute: Float[Tensor, "n 2"]
    """Its .grad is the sum over pixels of |d loss / d (2D mean)| through each pixel, if it asks for one: it costs
    more than the other."""

    @staticmethod
    def zeros(count: int, like: Tensor, *, absolute: bool = True) -> "ScreenProbe":
        """A fresh probe for `count` Gaussians in the dtype of `like`.

        Args:
            count: Number of Gaussians n.
            like: Any tensor of the dtype (and device) that the probe is to have.
            absolute: Whether absolute gradients are collected.
        """
        return ScreenProbe(
            signed=like.new_zeros(count, 2, requires_grad=True),
            absolute=like.new_zeros(count, 2, requires_grad=absolute),
        )


class _Collect(torch.autograd.Function):
    """Identity on the offsets; backward leaves sums and absolute sums over pixels in the probe."""

    @staticmethod
    def forward(ctx, offsets, signed, absolute):
        return offsets.clone()

    @staticmethod
    def backward(ctx, *grad_outputs):
        # offset = pixel - mean, hence the sign
        (gradient,) = grad_outputs
        return gradient, -gradient.sum(dim=0), gradient.abs().sum(dim=0)


def pixel_offsets(
    pixels: Float[Tensor, "p 2"], means: Float[Tensor, "n 2"], probe: ScreenProbe | None
) -> Float[Tensor, "p n 2"]:
    """Offsets pixel - mean; gradients that flow back through them are left in the probe.

    Args:
        pixels: Pixel centres (x, y), in pixels.
        means: 2D means (x, y) of the Gaussians, in pixels.
        probe: Where backward leaves the gradients by the means; None: nowhere.

    Returns: Pixels; entry (i, j) leads from Gaussian j to pixel i.

    Source: signed, Kerbl et al. 2023, Sec. 5.2; absolute, Ye et al. 2024, "AbsGS", Eq. 4.
    """
    offsets = pixels[:, None, :] - means[None, :, :]
    if probe is None:
        return offsets
    return _Collect.apply(offsets, probe.signed, probe.absolute)
