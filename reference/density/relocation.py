"""Relocation: a Gaussian becomes a stack of several that shows the same, and the noise between."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

MOST_COPIES = 51
"""A stack of more is made as one of so many: the releases bound it too (50 and 51)."""
MOST_OPAQUE = 1 - 2**-23
"""No Gaussian of a stack is more opaque: its logit stays finite in float32."""
GATE_SLOPE, GATE_OPACITY = 100.0, 0.005
"""Slope of the gate on noise, and the opacity at which it is half open."""


def stacked(
    opacities: Float[Tensor, " n"],
    scales: Float[Tensor, "n 3"],
    copies: Int[Tensor, " n"],
    *,
    least: float = 0.0,
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """Opacity o' = 1 - (1 - o)^(1/k) and scales s' = s o / D of each of k Gaussians in place of one.

    D = sum_{j=1..k} C(k, j) (-1)^(j+1) o'^j / sqrt(j) is the integral of the stack's opacity along a line
    through its centre, over that of one Gaussian of opacity 1, so that it shows as much as before; k = 1
    changes nothing. Computed in float64: with k = 51 terms of other signs reach 1e5 where D is near 1.

    Args:
        opacities: Opacity o of each Gaussian, in [0, 1].
        scales: Standard deviations in scene units.
        copies: Number k of Gaussians that each one is to be, >= 1; more than 51 count as 51.
        least: Least opacity o', in [0, 1); D follows what is raised to it, as in gsplat.

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Eq. 9 and
        appendix B; the sum over Gaussians of the stack, sum_i C(i - 1, j - 1) = C(k, j), is ours.
    """
    k = copies.clamp(max=MOST_COPIES)
    o = opacities.double().clamp(max=MOST_OPAQUE)
    each = -torch.expm1(torch.log1p(-o) / k)
    each = each.clamp(least, MOST_OPAQUE)
    orders = torch.arange(1, MOST_COPIES + 1, device=o.device)
    factors = o.new_tensor(
        [[math.comb(n, j) * (-1) ** (j + 1) / math.sqrt(j) for j in orders.tolist()]
         for n in range(MOST_COPIES + 1)]
    )  # fmt: skip
    integral = (factors[k] * each[:, None] ** orders).sum(dim=1)
    ratio = torch.where(integral > 0, o / integral, 1.0)
    return each.to(opacities), (scales.double() * ratio[:, None]).to(scales)


def nudges(
    covariances: Float[Tensor, "n 3 3"],
    opacities: Float[Tensor, " n"],
    draws: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 3"]:
    """Noise on positions before its strength: Sigma xi / (1 + exp(100 (o - 0.005))).

    Args:
        covariances: Covariance Sigma of each Gaussian, in squared scene units.
        opacities: Opacity o of each Gaussian, in [0, 1]; opaque ones hardly move.
        draws: xi, drawn from N(0, I).

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Sec. 4.1,
        and its release (Sigma itself, not its root).
    """
    gate = torch.sigmoid(-GATE_SLOPE * (opacities - GATE_OPACITY))
    return (covariances @ (draws * gate[:, None])[:, :, None])[:, :, 0]
