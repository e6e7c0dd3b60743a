"""A view's depth prior, whose scale nobody knows, as a depth between 0 and 1 that adaptation starts from, and how far
it is to be believed."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.methods.priors.alignment import aligned
from splatproof.reference.layered_memory.depth_adaptation import (
    AdaptationSettings,
    SparseDepths,
    align,
)
from splatproof.reference.types.scene import DepthPrior

NEAR_SHARE, FAR_SHARE = 0.02, 0.98
"""Quantiles of the prior's depth that become 0.1 and 0.9: one wild pixel must not squeeze the others."""
LEAST, MOST = 0.02, 0.98
"""Bounds of what is beyond them: a depth of 0 or 1 has no logit."""
BELIEVED = 0.5
"""A prior is left out where its error at the points is more than this share of what a constant leaves there."""
RATE_OF_ERROR, LEAST_RATE = 0.6, 0.003
"""Guidance's step for each unit of that error, and the least: a prior that is right is not torn to points that are not.
Chosen by the error of completed depths on four made scenes, where 0.3 to 1.2 are alike, and at the points of structure from
motion in three flights, which are the further off the lower it is."""
TRIMMED = 0.1
"""Share of the points, the worst, whose errors do not count."""
FEWEST_POINTS = 10
"""With fewer than so many nobody can tell how far a prior is off."""


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


def believed(
    prior: Float[Tensor, "h w"], known: SparseDepths, unit: float, settings: AdaptationSettings
) -> tuple[Float[Tensor, "h w"] | None, AdaptationSettings]:
    """The prior, or None where the known depths contradict it, and settings whose steps are as long as it is wrong.

    A prior that is nearly right everywhere loses more by steps to known depths, of which some are wrong, than it gains;
    one that is wrong needs long ones; one that is hardly better than a constant only harms.

    Args:
        prior: Depth in (0, 1), as `relative_depth` makes it.
        known: Depths that guide, scene units.
        unit: What depths are divided by, scene units (`depth_unit`).
        settings: For photos without a prior.

    Source: ours.
    """
    if len(known.depths) < FEWEST_POINTS:
        return prior, settings
    depth = prior.double()
    scale, shift = align(depth, known)
    at = scale * depth[known.rows, known.columns] + shift
    error = _typical(at - known.depths) / unit
    constant = _typical(known.depths - known.depths.median()) / unit
    if error > BELIEVED * constant:
        return None, settings
    rate = min(settings.learning_rate, max(LEAST_RATE, RATE_OF_ERROR * error))
    return prior, replace(settings, learning_rate=rate)


def _typical(errors: Float[Tensor, " n"]) -> float:
    """Mean size of all but the largest errors, which are of wrong points. A median would be 0 of a flat ground that
    more than half of the points lie on."""
    sizes = errors.abs().sort().values
    return float(sizes[: len(sizes) - int(TRIMMED * len(sizes))].mean())


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
