"""Nearest Gaussians by a tree: twins of what unpooling and co-pruning define by all distances."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.reference.sparse_views.unpooling import NEIGHBOURS


def nearest_others(means: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n k"], Int[Tensor, "n k"]]:
    """Twin of unpooling.nearest_others in O(n log n): of equally near ones any comes first.

    Args:
        means: World positions in scene units; distances are computed in float64.
    """
    count = max(0, min(NEIGHBOURS, len(means) - 1))
    if count == 0:
        return means.new_zeros(len(means), 0), torch.zeros(len(means), 0, dtype=torch.int64)
    positions = means.double().cpu().numpy()
    distances, rows = map(np.asarray, KDTree(positions).query(positions, k=count + 1))
    own = rows == np.arange(len(rows))[:, None]
    own[~own.any(axis=1), -1] = True  # duplicates: all those found are others, one too many
    shape = (len(rows), count)
    return (
        torch.from_numpy(distances[~own].reshape(shape)).to(means),
        torch.from_numpy(rows[~own].reshape(shape).astype(np.int64)).to(means.device),
    )


def matched(
    means: Float[Tensor, "n 3"], other: Float[Tensor, "m 3"], distance: float
) -> Bool[Tensor, " n"]:
    """Twin of co_pruning.matched in O(n log m), in float64.

    Args:
        means: World positions of a field's Gaussians, scene units.
        other: World positions of the other field's.
        distance: In scene units, >= 0.
    """
    if len(other) == 0 or len(means) == 0:
        return torch.zeros(len(means), dtype=torch.bool, device=means.device)
    found, _ = KDTree(other.double().cpu().numpy()).query(means.double().cpu().numpy())
    return torch.from_numpy(found <= distance).to(means.device)
