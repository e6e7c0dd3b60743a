"""Pre-cleaning: primitives that are invisible or unstable go before a merged model is refined."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class CleanSettings:
    """What is thrown away."""

    least_logit: float = -4.595
    """Opacity logit that a Gaussian must exceed to stay; -4.595 is opacity 0.01."""
    largest_scale: float = 50.0
    """Length in scene units that each of its scales must stay below."""
    volume_quantile: float = 0.999
    """Share, 0 to 1, of the Gaussians left that stay, the smallest by volume; 1: all (the paper:
    0.999)."""
    volume_of_logs: bool = False
    """Whether volumes are ranked by the product of the log scales, which is no volume, as in the
    release."""


AS_RELEASED = CleanSettings(volume_of_logs=True)
"""What the authors' code does: it ranks volumes by the product of the log scales."""


def preclean(
    opacity_logits: Float[Tensor, " n"], log_scales: Float[Tensor, "n 3"], settings: CleanSettings
) -> Bool[Tensor, " n"]:
    """Which primitives stay: logit > tau and exp(scale) < bound, then volume <= its 0.999 quantile.

    Volumes are compared by the sum of the log scales: their product would underflow. A rule that
    would leave nothing is skipped, so a model is never emptied; numbers that are not finite go first.

    Args:
        opacity_logits: Opacity of each primitive before the sigmoid.
        log_scales: Natural logarithms of the standard deviations.
        settings: Least opacity logit, largest scale and the quantile of volumes.

    Source: StitchGS, Sec. 3.2.4; never empty: ours (spec: GCR).
    """
    finite = opacity_logits.isfinite() & ~log_scales.isnan().any(dim=1)
    finite &= (log_scales < torch.inf).all(dim=1)
    kept = finite & (opacity_logits > settings.least_logit)
    kept &= (log_scales.exp() < settings.largest_scale).all(dim=1)
    if not bool(kept.any()):
        kept = finite
    if not bool(kept.any()):
        return torch.ones_like(kept)
    volume = log_scales.prod(dim=1) if settings.volume_of_logs else log_scales.sum(dim=1)
    volume = volume.double().where(~volume.isnan(), 0)  # of the release: (-inf) 0, of a scale of 0
    # numpy: torch.quantile refuses more than 16 million numbers. "lower" keeps what a line between two
    # volumes would, and between -inf, of a scale of 0, and a number there is none.
    bound = np.quantile(volume[kept].numpy(), settings.volume_quantile, method="lower")
    return kept & (volume <= float(bound))
