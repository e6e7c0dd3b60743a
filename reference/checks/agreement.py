"""How far a result is from the truth, with NaN never counted as near."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool
from torch import Tensor


def largest_error(value: Tensor, truth: Tensor, ignore: Bool[Tensor, "h w"] | None = None) -> float:
    """Largest |value - truth|; infinite if anything is not finite on one side only, or NaN.

    Args:
        value: What is judged, [h, w] or [h, w, c].
        truth: What is right, in the same shape.
        ignore: Pixels that do not count, e.g. those at a discontinuity; None: all count.

    Returns: 0 where nothing is left to compare.

    Raises: ValueError if the shapes differ.
    """
    if value.shape != truth.shape:
        raise ValueError(f"shapes differ: {tuple(value.shape)} against {tuple(truth.shape)}")
    value, truth = value.detach(), truth.detach()
    error = (value.double() - truth.double()).abs()
    error = torch.where(torch.isfinite(value) & torch.isfinite(truth), error, math.inf)
    if ignore is not None:
        error = error[~ignore]
    return float(error.max()) if error.numel() else 0.0


@dataclass(frozen=True, kw_only=True)
class GradientAgreement:
    """How near a gradient is to the true one."""

    relative_l2: float
    """|value - truth| / |truth|; infinite for NaN, 0 if both are zero."""
    cosine: float
    """Cosine of the angle between the two; 1 if both are zero, -1 for NaN."""

    def good(self, relative_l2: float = 1e-3, cosine: float = 0.9999) -> bool:
        """Whether both stay within the given bounds.

        Args:
            relative_l2: Largest relative L2 distance that still is good, >= 0.
            cosine: Smallest cosine that still is good, in [-1, 1].
        """
        return self.relative_l2 <= relative_l2 and self.cosine >= cosine


def compare_gradients(value: Tensor, truth: Tensor, *, floor: float = 0.0) -> GradientAgreement:
    """Relative L2 distance and cosine of two gradients of one shape.

    Args:
        value: What is judged.
        truth: The true gradient.
        floor: Norms below this count as zero: a true gradient of 0 that comes out as rounding of
            larger terms has no direction.

    Raises: ValueError if the shapes differ.
    """
    if value.shape != truth.shape:
        raise ValueError(f"shapes differ: {tuple(value.shape)} against {tuple(truth.shape)}")
    a, b = value.detach().double().flatten(), truth.detach().double().flatten()
    if not bool(torch.isfinite(a).all() and torch.isfinite(b).all()):
        return GradientAgreement(relative_l2=math.inf, cosine=-1.0)
    na, nb = float(a.norm()), float(b.norm())
    if na <= floor and nb <= floor:
        return GradientAgreement(relative_l2=0.0, cosine=1.0)
    if na == 0 or nb == 0:
        return GradientAgreement(relative_l2=math.inf, cosine=0.0)
    return GradientAgreement(
        relative_l2=float((a - b).norm()) / nb, cosine=float(a @ b) / (na * nb)
    )
