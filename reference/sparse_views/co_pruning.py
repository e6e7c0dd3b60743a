"""Co-pruning: what only one of two fields believes in is removed."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def matched(
    means: Float[Tensor, "n 3"], other: Float[Tensor, "m 3"], distance: float
) -> Bool[Tensor, " n"]:
    """Gaussians with one of the other field within a distance: min_j |mu_i - nu_j| <= d.

    One way: the other field's mask is another call. The direct form, in O(n m) time.

    Args:
        means: World positions of a field's Gaussians, scene units.
        other: World positions of the other field's.
        distance: d in scene units, >= 0. The release has 5 to 20 by data set.

    Source: Zhang et al. 2024, "CoR-GS", Sec. 4.2, Eqs. 4 and 5.
    """
    if len(other) == 0:
        return torch.zeros(len(means), dtype=torch.bool)
    return (means[:, None] - other[None]).norm(dim=2).amin(dim=1) <= distance
