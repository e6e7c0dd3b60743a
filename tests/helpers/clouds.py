"""Random sparse points with tracks, small enough to check by hand."""

import torch
from torch import Tensor

from splatproof.reference.types.scene import SparsePoints


def tracked(views_of_points: list[list[int]], positions: Tensor | None = None) -> SparsePoints:
    """Sparse points that are seen by the listed views; at the origin unless told."""
    count = len(views_of_points)
    lengths = torch.tensor([0] + [len(views) for views in views_of_points])
    seen = [view for views in views_of_points for view in views]
    return SparsePoints(
        positions=torch.zeros(count, 3, dtype=torch.float64) if positions is None else positions,
        colours=torch.zeros(count, 3, dtype=torch.uint8),
        track_starts=lengths.cumsum(0),
        track_views=torch.tensor(seen, dtype=torch.int64),
    )


def cloud(count: int, seed: int, *, cells: int = 6, most: int = 9) -> tuple[Tensor, Tensor]:
    """Positions on a lattice of 1/64 in a flat box of `cells` units, and loads from 0 to `most`.

    Lattice positions stay exact when they are moved by integers or scaled by powers of two.
    """
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor([cells * 64, cells * 64, 96])
    positions = (torch.rand(count, 3, generator=generator) * size).long().double() / 64
    return positions, torch.randint(0, most + 1, (count,), generator=generator)
