"""The Morton curve: an order of positions in which neighbours in space are near in memory."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

BITS = 21
"""Bits of a cell number along one axis; three of them fill an int64 but for the sign."""
SPREAD = ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
          (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249))  # fmt: skip
"""Shifts and masks that move bit i of a number to place 3 i."""


def morton_codes(
    positions: Float[Tensor, "n 3"], low: Float[Tensor, "3"], high: Float[Tensor, "3"]
) -> Int64[Tensor, " n"]:
    """Place of each position on the Morton (Z-order) curve through the box [low, high].

    The box is cut into 2^21 cells along each axis; the code holds the bits of the three cell
    numbers in turn. Positions outside count as the nearest within.

    Args:
        positions: Positions in the frame of the box.
        low: Lowest corner of the box.
        high: Highest corner; along an axis on which it is no higher than `low`, all cells are 0.

    Source: Morton 1966, "A computer oriented geodetic data base".
    """
    size = (high - low).double()
    scale = torch.where(size > 0, (2**BITS - 1) / size.clamp(min=1e-300), 0)
    cells = ((positions.double() - low) * scale).clamp(0, 2**BITS - 1).long()
    codes = torch.zeros(len(positions), dtype=torch.int64)
    for axis in range(3):
        spread = cells[:, axis]
        for shift, mask in SPREAD:
            spread = (spread | spread << shift) & mask
        codes |= spread << axis
    return codes


def morton_order(positions: Float[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
    """Indices that sort positions along the Morton curve through the box around them."""
    if len(positions) == 0:
        return torch.zeros(0, dtype=torch.int64)
    codes = morton_codes(positions, positions.amin(dim=0), positions.amax(dim=0))
    return codes.argsort(stable=True)
