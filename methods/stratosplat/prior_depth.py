"""A view's depth prior, whose scale nobody knows, as a depth between 0 and 1 that adaptation starts from."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.methods.priors.alignment import aligned
from splatproof.reference.layered_memory.depth_adaptation import SparseDepths
from splatproof.reference.types.scene import DepthPrior

NEAR_SHARE, FAR_SHARE = 0.02, 0.98
"""Quantiles of the prior's depth that become 0.1 and 0.9: one wild pixel must not squeeze the others."""
LEAST, MOST = 0.02, 0.98
"""Bounds of what is beyond them: a depth of 0 or 1 has no logit."""


def relative_depth(
    prior: DepthPrior, sparse: SparseDepths, size: tuple[int, int]
) -> Float[Tensor, "h w"] | None:
    """Depth in (0, 1) that says what the prior says; None where it says nothing.

    Disparity is brought to the scale of the sparse points, by which alone it becomes a depth; where
    they do not determine it, 1 - disparity is taken over its range. Pixels that are not valid get the
    mean of the valid ones around them.

    Args:
        prior: Disparity of unknown scale and zero, at any size.
        sparse: z-depths of sparse points in the view, at `size`.
        size: Height and width of the result.

    Source: ours.
    """
    disparity, valid = _resized(prior, size)
    if not bool(valid.any()):
        return None
    known = valid[sparse.rows, sparse.columns] & (sparse.depths > 0)
    at = disparity[sparse.rows[known], sparse.columns[known]]
    fit = aligned(at, 1 / sparse.depths[known]) if int(known.sum()) >= 2 else None
    if fit is not None and fit[0] > 0:
        true = fit[0] * disparity + fit[1]
        floor = true[valid].quantile(0.5) / 100  # what is not in front of the camera is far
        depth = 1 / true.clamp(min=float(floor.clamp(min=1e-12)))
    else:
        depth = -disparity
    low, high = (float(depth[valid].quantile(q)) for q in (NEAR_SHARE, FAR_SHARE))
    share = (depth - low) / max(high - low, 1e-12 * max(abs(high), 1e-30))
    return _filled((0.1 + 0.8 * share).clamp(LEAST, MOST), valid)


def _resized(
    prior: DepthPrior, size: tuple[int, int]
) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """Disparity as the mean of the valid pixels of a cell, and where there is one."""
    weight = prior.valid.double()[None, None]
    total = prior.disparity.double().where(prior.valid, 0)[None, None]
    if prior.disparity.shape != size:
        weight, total = (functional.interpolate(x, size, mode="area") for x in (weight, total))
    valid = weight[0, 0] > 0
    return torch.where(valid, total[0, 0] / weight[0, 0].where(valid, 1), 0), valid


def _filled(depth: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """The depth with means of the valid pixels around where it is not known, in growing windows."""
    while not bool(valid.all()):
        weight = valid.to(depth)[None, None]
        share = functional.avg_pool2d(weight, 3, 1, 1)[0, 0]
        mean = functional.avg_pool2d(depth.where(valid, 0)[None, None], 3, 1, 1)[0, 0]
        reached = share > 0
        depth = torch.where(~valid & reached, mean / share.where(reached, 1), depth)
        valid = valid | reached
    return depth
