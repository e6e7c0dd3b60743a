"""Which views see which sparse points, and the views a block needs because they see its points."""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from splatproof.reference.types.scene import SparsePoints


def track_lengths(points: SparsePoints) -> Int[Tensor, " n"]:
    """Number l(p) of views that see each point.

    Source: DPGS, Sec. 3.3 (visibility complexity).
    """
    return points.track_starts.diff()


def shared_points(
    points: SparsePoints, chosen: Bool[Tensor, " n"], view_count: int
) -> Int[Tensor, " v"]:
    """Number of chosen points that each view sees: |P_v & P_k|.

    Args:
        points: Sparse points with their tracks.
        chosen: The points P_k of a block.
        view_count: Number of views in the scene; views without points get 0.
    """
    kept = torch.repeat_interleave(chosen, track_lengths(points))
    return torch.bincount(points.track_views[kept], minlength=view_count)


def covering_views(
    points: SparsePoints,
    chosen: Bool[Tensor, " n"],
    view_count: int,
    *,
    view_share: float,
    block_share: float,
) -> Bool[Tensor, " v"]:
    """Views with |P_v & P_k| / |P_v| >= view_share or |P_v & P_k| / |P_k| >= block_share.

    A view that sees no point of the block is never taken, whatever the shares. BlockGaussian's
    release compares with > instead of >=; only exact ties differ.

    Args:
        points: Sparse points with their tracks.
        chosen: The points P_k inside the block's widened box.
        view_count: Number of views in the scene.
        view_share: tau_view in [0, 1]: least share of a view's points that the block must hold.
        block_share: tau_block in [0, 1]: least share of the block's points that a view must see.

    Source: StitchGS, Sec. 3.2.1; BlockGaussian's release (0.3 and 0.1).
    """
    shared = shared_points(points, chosen, view_count)
    seen = shared_points(points, torch.ones_like(chosen), view_count)
    of_view = shared.double() / seen.clamp(min=1)
    of_block = shared.double() / chosen.sum().clamp(min=1)
    return (shared > 0) & ((of_view >= view_share) | (of_block >= block_share))
