"""Soft ranks and the Spearman correlation built of them: depth order without discrete ranks."""

import torch
from jaxtyping import Float
from torch import Tensor

ROWS_AT_ONCE = 1024
"""Rows of the pairwise table held at a time; memory only."""


def soft_rank(values: Float[Tensor, " n"], temperature: float) -> Float[Tensor, " n"]:
    """Soft rank r_i = sum_j sigmoid((z_j - z_i) / tau): about how many values lie above z_i.

    The sum runs over all j, i itself included, which adds 1/2 to every rank. The direct form, in
    O(n^2) time: fast twins say their error against it.

    Args:
        values: Finite numbers.
        temperature: tau > 0, in the unit of the values; tau -> 0 gives the discrete rank.

    Raises: ValueError if tau is not positive or a value is not finite.

    Source: HDGS, Eq. 9.
    """
    if not temperature > 0:
        raise ValueError(f"temperature must be positive: {temperature}")
    if not values.isfinite().all():
        raise ValueError("soft ranks need finite values: mask the others out first")
    parts = [
        torch.sigmoid((values[None] - part[:, None]) / temperature).sum(dim=1)
        for part in values.split(ROWS_AT_ONCE)
    ]
    return torch.cat(parts) if parts else values


def correlation(a: Float[Tensor, " n"], b: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    """Pearson correlation in [-1, 1]; 0 with zero gradient where either one is constant.

    Args:
        a: One vector of finite numbers.
        b: The other, in any unit of its own.
    """
    if len(a) < 2:
        return (a.sum() + b.sum()) * 0
    a, b = a - a.mean(), b - b.mean()
    power = (a * a).sum() * (b * b).sum()
    # A constant vector keeps rounding noise of about n eps |mean|, far below any real spread.
    varies = power > torch.finfo(a.dtype).tiny
    return torch.where(varies, (a * b).sum() / torch.where(varies, power, 1).sqrt(), 0)


def spearman(
    a: Float[Tensor, " n"], b: Float[Tensor, " n"], temperature: float
) -> Float[Tensor, ""]:
    """Approximate Spearman correlation: Pearson of the two soft-rank vectors, in [-1, 1].

    Args:
        a: One vector of finite numbers.
        b: The other, in the same unit, since both are ranked with one temperature.
        temperature: tau > 0, in the unit of the values.

    Source: HDGS, Eq. 10.
    """
    return correlation(soft_rank(a, temperature), soft_rank(b, temperature))


def global_depth_loss(
    rendered: Float[Tensor, " n"], estimated: Float[Tensor, " n"], temperature: float
) -> Float[Tensor, ""]:
    """L_g = 1 - rho: depth order, not depth, is supervised. In [0, 2].

    Args:
        rendered: Rendered depth at a sample of pixels.
        estimated: Monocular depth (not disparity) at these pixels, scaled to the same spread.
        temperature: tau > 0 of the soft ranks, in the unit of both depths.

    Source: HDGS, Eq. 11.
    """
    return 1 - spearman(rendered, estimated, temperature)
