"""Errors of a depth map against the true one."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError

RATIO = 1.25
"""delta_k counts pixels whose depth is off by a factor below RATIO^k."""


def depth_errors(
    depth: Float[Tensor, "h w"],
    truth: Float[Tensor, "h w"],
    mask: Bool[Tensor, "h w"] | None = None,
) -> dict[str, float]:
    """AbsRel, SqRel, RMSE and delta_1..3 over the pixels whose true depth is known.

    abs_rel = mean |d - t| / t, sq_rel = mean (d - t)^2 / t (scene units), rmse = sqrt mean
    (d - t)^2 (scene units), delta_k = share with max(d / t, t / d) < 1.25^k. Depths are taken as
    they are: neither scaled to the truth nor capped. A pixel where nothing is drawn (d = 0) stays in
    every mean and is outside every delta.

    Args:
        depth: z-depth in scene units, >= 0 and finite where it counts.
        truth: True z-depth in scene units; inf or <= 0: unknown, does not count.
        mask: True where a pixel counts; None: everywhere.
    Returns: abs_rel, sq_rel, rmse (lower is better), delta1, delta2, delta3 (higher is better), and
        depth_share: the share of pixels that counted. Without one all others are nan.
    Raises: DataError on nan in the truth, or a counted depth that is negative or not finite.
    Source: Eigen et al. 2014, "Depth Map Prediction from a Single Image", Sec. 4.
    """
    if bool(truth.isnan().any()):
        raise DataError(f"true depth: nan{_where(truth.isnan())}; mark unknown depth with inf or 0")
    counted = truth.isfinite() & (truth > 0)
    if mask is not None:
        counted &= mask
    bad = counted & ~(depth.isfinite() & (depth >= 0))
    if bool(bad.any()):
        value = float(depth[bad][0])
        raise DataError(f"depth: {value:g}{_where(bad)}, expected finite values >= 0")
    d, t = depth[counted].double(), truth[counted].double()
    error = d - t
    ratio = torch.maximum(d / t, t / d)  # inf where nothing is drawn
    values = {
        "abs_rel": float((error.abs() / t).mean()),
        "sq_rel": float((error**2 / t).mean()),
        "rmse": math.sqrt(float((error**2).mean())),
    }
    for k in (1, 2, 3):
        values[f"delta{k}"] = float((ratio < RATIO**k).double().mean())
    return values | {"depth_share": float(counted.double().mean())}


def _where(bad: Bool[Tensor, "h w"]) -> str:
    row, column = bad.nonzero()[0].tolist()
    return f" at row {row}, column {column} ({int(bad.sum())} such pixels)"
