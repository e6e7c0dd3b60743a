"""Depth by correlation with a prior: what is rendered rises where the prior says that it does."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.supervision.soft_rank import correlation

POLE = 0.1
"""What is added to a prior in [0, 1] before it is inverted (ours; the release adds 200 to a network
of another range)."""


def correlation_loss(
    depth: Float[Tensor, "h w"], disparity: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"]
) -> Float[Tensor, ""]:
    """min(1 - rho(-M, D), 1 - rho(1 / (M + c), D)) with Pearson's rho over the valid pixels, in [0, 2].

    A prior's scale and zero are unknown, so it is brought to [0, 1] first; of the two readings of
    it, disparity turned round and its inverse, the one that fits better counts. A constant depth or
    prior has loss 1 and zero gradient (the release has none: NaN).

    Args:
        depth: D, sum of w_i z_i over each pixel, not divided by the weights, in any unit.
        disparity: M, larger where nearer; only read where it is valid.
        valid: Pixels of which the prior says anything.

    Source: Zhu et al. 2024, "FSGS", Sec. 3.2, Eq. 6, and its release.
    """
    rendered, prior = depth[valid], disparity[valid]
    if len(prior) == 0:
        return depth.new_ones(())
    low, high = prior.min(), prior.max()
    prior = (prior - low) / torch.where(high > low, high - low, 1)
    losses = [1 - correlation(each, rendered) for each in (-prior, 1 / (prior + POLE))]
    return torch.minimum(*losses)
