"""How large the cells of positions are to be in a coded file, and what makes them larger."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from splatproof.reference.compression import quantisers
from splatproof.reference.types.gaussians import Gaussians

NOTICED = 1.5
"""Times as large as asked from which cells are worth a word."""


@dataclass(frozen=True, kw_only=True)
class Widened:
    """Cells that are larger than asked, because some Gaussians lie beyond the reach of those."""

    times: float
    """Their side over the one that was asked for, > NOTICED."""
    reach: float
    """How far from the origin cells of the side asked for reach along an axis, in units of the frame."""
    beyond: int
    """Gaussians that lie farther out."""
    farthest: float
    """How far out the farthest lies along an axis, in units of the frame."""


def asked_cell(middles: Float64[np.ndarray, " n"], share: float) -> float:
    """Side of a cell: a share of the median Gaussian's middle scale, or of 1 where there is none.

    Args:
        middles: Logarithm of each Gaussian's middle scale.
        share: CodeSettings.position, > 0.

    Source: ours.
    """
    return share * (float(np.exp(np.median(middles))) if len(middles) else 1.0)


def least_cell(reach: float) -> float:
    """Side of the smallest cells that reach so far from the origin along an axis, in units of the frame."""
    return max(reach / quantisers.MOST_CELL * (1 + 1e-9), 1e-12)


def widened(model: Gaussians, share: float, side: float) -> Widened | None:
    """What makes a model's cells noticeably larger than asked; None: they are not.

    Args:
        model: What is stored, its positions finite.
        share: Side that was asked for, as a share of the median Gaussian's middle scale, > 0.
        side: Side of the file's cells, in units of the frame, > 0.

    Source: ours.
    """
    asked = asked_cell(np.median(model.log_scales.detach().double().numpy(), axis=1), share)
    out = model.means.detach().double().abs().amax(dim=1)
    reach = asked * quantisers.MOST_CELL
    beyond = int(torch.count_nonzero(out > reach))
    if side <= NOTICED * asked or not beyond:  # none: what was trained has shrunk since
        return None
    return Widened(times=side / asked, reach=reach, beyond=beyond, farthest=float(out.max()))
