"""Spectral energy of spherical harmonics, and the gate that drops view dependence where it is weak."""

from itertools import pairwise
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

GATE = 0.02
"""gamma: energy from which harmonics are kept (StitchGS, Sec. 4.1.2)."""
Weighting = Literal["coefficients", "orders"]


def order_energies(rest: Float[Tensor, "n r 3"]) -> Float[Tensor, "n l"]:
    """Energy of each order l >= 1: E_l = mean |f| over its 2 l + 1 coefficients of 3 channels.

    Args:
        rest: SH coefficients without DC; r is 0, 3, 8 or 15 for degree 0 to 3.

    Returns: One column an order; none for degree 0.

    Source: StitchGS, Sec. 3.3.1.
    """
    degree = {0: 0, 3: 1, 8: 2, 15: 3}[rest.shape[1]]
    ends = [(order + 1) ** 2 - 1 for order in range(degree + 1)]
    columns = [rest[:, a:b].abs().mean(dim=(1, 2)) for a, b in pairwise(ends)]
    return torch.stack(columns, dim=1) if columns else rest.new_zeros(len(rest), 0)


def energy(
    rest: Float[Tensor, "n r 3"], weighting: Weighting = "coefficients"
) -> Float[Tensor, " n"]:
    """Aggregated energy E = sum_l omega_l E_l of each primitive; 0 for degree 0.

    The paper's "uniform weighting" is said to equal the mean over all residual numbers. That holds
    for omega_l proportional to the numbers in an order (9, 15, 21 of 45), the default here; equal
    weights an order are the other reading.

    Args:
        rest: SH coefficients without DC.
        weighting: "coefficients": the mean of all |f|; "orders": the mean of the E_l.

    Source: StitchGS, Sec. 3.3.1.
    """
    per_order = order_energies(rest)
    if per_order.shape[1] == 0:
        return rest.new_zeros(len(rest))
    sizes = torch.arange(1, per_order.shape[1] + 1).to(rest) * 2 + 1
    omega = sizes if weighting == "coefficients" else torch.ones_like(sizes)
    return per_order @ (omega / omega.sum())


def open_gate(
    rest: Float[Tensor, "n r 3"], gate: float = GATE, weighting: Weighting = "coefficients"
) -> Bool[Tensor, " n"]:
    """Which primitives keep their residual: E >= gamma.

    Args:
        rest: SH coefficients without DC.
        gate: gamma >= 0, the energy from which a primitive keeps its residual.
        weighting: How orders are weighed in the energy, see `energy`.
    """
    return energy(rest, weighting) >= gate


def gated(
    rest: Float[Tensor, "n r 3"], gate: float = GATE, weighting: Weighting = "coefficients"
) -> Float[Tensor, "n r 3"]:
    """Residual coefficients, 0 where the energy is below gamma; gamma = 0 changes nothing.

    Args:
        rest: SH coefficients without DC.
        gate: gamma >= 0, the energy from which a primitive keeps its residual.
        weighting: How orders are weighed in the energy, see `energy`.

    Source: StitchGS, Sec. 3.3.1 (spectral gate).
    """
    return torch.where(open_gate(rest, gate, weighting)[:, None, None], rest, 0)
