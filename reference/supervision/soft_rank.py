"""Soft ranks and the Spearman correlation built of them: depth order without discrete ranks."""

import torch
from jaxtyping import Float
from torch import Tensor

ROWS_AT_ONCE = 1024
"""Rows of the pairwise table held at a time; memory only."""
ROUNDING = 4.0
"""Spread of a constant vector at most, in units in the last place of its largest value."""


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


def standardised(values: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """(z - mean) / deviation; all 0, and with zero gradient, where z is constant.

    A spread of a few units in the last place of the largest value is rounding, so it counts as
    constant: divided by itself it would be noise with a gradient of one over the noise (ours).

    Args:
        values: Numbers in any unit.

    Raises: ValueError if a value is not finite.
    """
    if not values.isfinite().all():
        raise ValueError("soft ranks need finite values: mask the others out first")
    if len(values) == 0:
        return values
    span = (values.max() - values.min()).detach()
    varies = span > ROUNDING * torch.finfo(values.dtype).eps * values.abs().max()
    # Divided by the span first, since squares of very small or large numbers leave the dtype.
    centred = (values - values.mean()) / torch.where(varies, span, 1)
    deviation = torch.where(varies, centred.square().mean(), 1).sqrt()
    return torch.where(varies, centred / deviation, 0)


def correlation(a: Float[Tensor, " n"], b: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    """Pearson correlation in [-1, 1]; 0 with zero gradient where either one is constant.

    Args:
        a: One vector of finite numbers.
        b: The other, in any unit of its own.
    """
    return (standardised(a) * standardised(b)).sum() / max(1, len(a))


def spearman(
    a: Float[Tensor, " n"], b: Float[Tensor, " n"], temperature: float
) -> Float[Tensor, ""]:
    """Approximate Spearman correlation: Pearson of the two soft-rank vectors, in [-1, 1].

    Each vector is divided by its standard deviation before it is ranked: one temperature cannot
    serve metres and the numbers of a network (ours).

    Args:
        a: One vector of finite numbers.
        b: The other, in any unit of its own.
        temperature: tau > 0, in standard deviations.

    Source: HDGS, Eq. 10.
    """
    ranks = [soft_rank(standardised(values), temperature) for values in (a, b)]
    return correlation(*ranks)


def global_depth_loss(
    rendered: Float[Tensor, " n"], estimated: Float[Tensor, " n"], temperature: float
) -> Float[Tensor, ""]:
    """L_g = 1 - rho: depth order, not depth, is supervised. In [0, 2].

    Args:
        rendered: Rendered depth at a sample of pixels.
        estimated: Monocular depth (not disparity) at these pixels, in any unit.
        temperature: tau > 0 of the soft ranks, in standard deviations of either depth.

    Source: HDGS, Eq. 11.
    """
    return 1 - spearman(rendered, estimated, temperature)
