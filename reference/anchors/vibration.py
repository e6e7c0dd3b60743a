"""Periodic vibration: coarse motion of an anchor about its centre, and its span of life."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def vibrate(
    centres: Float[Tensor, "n 3"],
    velocities: Float[Tensor, "n 3"],
    peaks: Float[Tensor, " n"],
    time: float,
    period: float,
) -> Float[Tensor, "n 3"]:
    """mu_0(t) = mu_0 + p / (2 pi) sin(2 pi (t - tau) / p) v.

    Args:
        centres: Positions mu_0 at the life peak, scene units.
        velocities: v at the life peak, scene units a unit of time.
        peaks: tau, the time of each life peak.
        time: t in the unit of the peaks, any value; the motion repeats with the period.
        period: p > 0, in the same unit.

    Raises: ValueError if the period is not positive.

    Source: HDGS, Eq. 1; Chen et al. 2023, "Periodic Vibration Gaussian", Eq. 5.
    """
    if not period > 0:
        raise ValueError(f"period must be positive: {period}")
    phase = torch.sin(2 * math.pi * (time - peaks) / period)
    return centres + (period / (2 * math.pi)) * phase[:, None] * velocities


def life(
    peaks: Float[Tensor, " n"], spans: Float[Tensor, " n"], time: float
) -> Float[Tensor, " n"]:
    """F(t) = exp(-((t - tau) / beta)^2 / 2), the factor on opacity; 1 at the peak.

    Args:
        peaks: tau, the time of each life peak.
        spans: beta > 0, in the unit of time.
        time: t, in the same unit.

    Raises: ValueError if a span is not positive.

    Source: HDGS, Eq. 6; Chen et al. 2023, "Periodic Vibration Gaussian", Eq. 6.
    """
    if not (spans > 0).all():
        raise ValueError(f"life spans must be positive: smallest {float(spans.min())}")
    return torch.exp(-0.5 * ((time - peaks) / spans).square())
