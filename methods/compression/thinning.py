"""Fewer Gaussians that look alike: pairs of near, alike ones become one, by what the photos see of them."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.methods.storage.visibility import visibility
from splatproof.reference.compression.merging import costs, matched, merged
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View

NEIGHBOURS = 8
"""Nearest Gaussians that each may be merged with."""
MOST = 0.9
"""Largest share that can be taken away."""
UNSEEN = 1e-6
"""Mass in pixels of a Gaussian that no view sees; the pixels that others are worth add to it."""
AT_ONCE = 0.25
"""Largest share that one round merges: of later rounds' pairs one may be a pair already."""
Way = Literal["merge", "prune"]


def thinned(
    model: Gaussians,
    views: Sequence[View],
    share: float,
    *,
    generator: torch.Generator,
    way: Way = "merge",
    mode: Mode = "classic",
    backend: str = "cpu",
) -> Gaussians:
    """The model with a share of its Gaussians less, chosen by their blending weights over views.

    Args:
        model: The Gaussians.
        views: Training views; their cameras suffice.
        share: Share that goes, 0 to 0.9.
        generator: Draws the signs of `visibility`.
        way: merge: pairs of near, alike ones become one (merging); prune: those of the least weight go.
        mode: How the model is rasterized.
        backend: Name of the rasterizer.

    Raises: UsageError for another share.

    Source: ours; see reference.compression.merging.
    """
    check_share(share, "share")
    weights = visibility(model, views, generator=generator, mode=mode, backend=backend).weights
    left = len(model) - round(share * len(model))
    if way == "prune":
        kept = weights.argsort(stable=True)[len(model) - left :].sort().values
        return Gaussians(**{name: values[kept] for name, values in vars(model).items()})
    mass = weights.double() + UNSEEN
    while len(model) > left:
        number = min(len(model) - left, max(1, int(AT_ONCE * len(model))))
        pairs = neighbours(model.means)
        chosen = matched(pairs, costs(model, pairs, mass), number)
        if not len(chosen):  # all that are left are too flat to be merged
            break
        model, mass = merged(model, chosen, mass)
    return model


def check_share(share: float, name: str) -> None:
    """Refuse a share of the Gaussians that cannot be taken away.

    Args:
        share: The share.
        name: Name of the setting, for the error.
    Raises: UsageError outside 0 to 0.9.
    """
    if not 0 <= share <= MOST:
        raise UsageError(f"{name} is {share}, expected a share of the Gaussians from 0 to {MOST}")


def neighbours(means: Float[Tensor, "n 3"]) -> Int64[Tensor, "p 2"]:
    """Each Gaussian with each of its NEIGHBOURS nearest, every pair once, the lower row first.

    Args:
        means: World positions in scene units.
    """
    count = min(NEIGHBOURS + 1, len(means))
    positions = means.double().numpy()
    near = np.asarray(KDTree(positions).query(positions, k=count)[1]).reshape(len(means), count)
    rows = np.repeat(np.arange(len(means)), count)
    pairs = np.stack([rows, near.reshape(-1)], axis=1)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    return torch.from_numpy(pairs.astype(np.int64))
