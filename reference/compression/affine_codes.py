"""8-bit affine codes: a lattice of 256 values for each dimension, and training through it."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from splatproof.base.errors import DataError

STEPS = 255
"""Largest code; the lattice has one value more."""
Rounding = Literal["nearest", "truncate"]


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineCodes:
    """Values m + r / 255 * code, with one m and r for each dimension."""

    codes: UInt8[Tensor, "n d"]
    low: Float32[Tensor, " d"]
    """m, the smallest value of each dimension."""
    range: Float32[Tensor, " d"]
    """r >= 0, largest minus smallest; 0 stores the constant m."""


def lattice(values: Float[Tensor, "n d"]) -> tuple[Float32[Tensor, " d"], Float32[Tensor, " d"]]:
    """Lowest value m and range r of each dimension over all primitives; 0, 0 without primitives.

    Raises: DataError for values that are not finite, or whose range is not (in float32).

    Source: StitchGS, Sec. 3.3.2.
    """
    if len(values) == 0:
        return torch.zeros(values.shape[1]), torch.zeros(values.shape[1])
    low, high = (
        values.amin(dim=0),
        values.amax(dim=0),
    )  # a value that is not finite shows in one of them
    if not bool((low.isfinite() & high.isfinite()).all()):
        bad = int((~values.isfinite()).sum())
        raise DataError(f"{bad} of {values.numel()} values to quantise are not finite: clean first")
    low = low.float()
    reach = (high.double() - low.double()).clamp(min=0).float()
    if not bool((low.isfinite() & reach.isfinite()).all()):
        raise DataError("values to quantise span more than float32 holds: clean the model first")
    return low, reach


def encode(values: Float[Tensor, "n d"], rounding: Rounding = "nearest") -> AffineCodes:
    """Codes clip(round(255 (f - m) / r), 0, 255) on the lattice of the values themselves.

    Args:
        values: Numbers to be stored, one row a primitive.
        rounding: "truncate" is what the authors' code does at export, although it trains with
            rounding: it is half a step too low on average.

    Raises: DataError for values that are not finite.

    Source: StitchGS, Sec. 3.3.2.
    """
    low, reach = lattice(values)
    steps = torch.where(reach > 0, STEPS * (values.double() - low) / reach.double(), 0)
    whole = steps.round() if rounding == "nearest" else steps.floor()
    return AffineCodes(codes=whole.clamp(0, STEPS).to(torch.uint8), low=low, range=reach)


def decode(codes: AffineCodes) -> Float32[Tensor, "n d"]:
    """Values m + r / 255 * code, off by at most r / 510 (rounded to nearest), plus float32's own."""
    return (codes.low.double() + codes.range.double() / STEPS * codes.codes.double()).float()


class _StraightThrough(torch.autograd.Function):
    """Forward: the nearest lattice value; backward: identity inside the range, 0 outside."""

    @staticmethod
    def forward(ctx, values, low, reach):
        code = (STEPS * (values - low) / torch.where(reach > 0, reach, 1)).round().clamp(0, STEPS)
        ctx.save_for_backward((values >= low) & (values <= low + reach))
        return torch.where(reach > 0, low + reach / STEPS * code, low.expand_as(values))

    @staticmethod
    def backward(ctx, *grad_outputs):
        (gradient,) = grad_outputs
        (within,) = ctx.saved_tensors
        return torch.where(within, gradient, 0), None, None


def fake_quantise(
    values: Float[Tensor, "n d"], low: Float[Tensor, " d"], reach: Float[Tensor, " d"]
) -> Float[Tensor, "n d"]:
    """Values as they will come back from 8 bits, with a straight-through gradient.

    With m and r of the values themselves (lattice) the gradient is the identity; with a lattice
    that was fixed earlier, values beyond it are clipped and get none.

    Args:
        values: Parameters that are trained, one row a primitive.
        low: m of each dimension, without gradient.
        reach: r of each dimension, without gradient; where 0, m is the only value.

    Source: StitchGS, Sec. 3.2.4 (Q_8, straight-through estimator).
    """
    return _StraightThrough.apply(values, low.to(values), reach.to(values))
