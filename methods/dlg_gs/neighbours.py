"""Which anchors are near which: lists in place of a mask of all pairs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels import attention as native


@dataclass(frozen=True, kw_only=True, eq=False)
class Neighbours:
    """Pairs (source, target) of anchors, sorted by source and then target; of each the reverse is there too.

    Every anchor is a neighbour of itself.
    """

    sources: Int[Tensor, " e"]
    targets: Int[Tensor, " e"]
    starts: Int[Tensor, " n"]
    """Where the pairs of each source begin."""

    @cached_property
    def reverse(self) -> Int[Tensor, " e"]:
        """Where the pair (target, source) of each pair stands; the kernels do without.

        Pairs sorted by target and then source are the reversed ones in their own order.
        """
        return self.targets.argsort(stable=True)

    @cached_property
    def native(self) -> _ext.NearLists:
        """The lists as the kernels read them."""
        return native.lists(self.starts, self.targets)

    def __getstate__(self) -> dict[str, Tensor]:
        """The tensors alone: snapshots of a training are pickled, and the kernels' form is made again."""
        return {name: vars(self)[name] for name in ("sources", "targets", "starts")}

    def among(self, chosen: Int[Tensor, " v"]) -> "Neighbours":
        """The pairs both of whose anchors are chosen, renumbered.

        Args:
            chosen: Rows of anchors, ascending.
        """
        place = self.starts.new_full((len(self.starts),), -1)
        place[chosen] = torch.arange(len(chosen), device=place.device)
        sources, targets = place[self.sources], place[self.targets]
        return self._kept((sources >= 0) & (targets >= 0), sources, targets, len(chosen))

    def within(self, centres: Float[Tensor, "n 3"], radius: float) -> "Neighbours":
        """The pairs that are no farther apart than a radius.

        Args:
            centres: Where the anchors stand.
            radius: In the unit of the centres, >= 0.
        """
        apart = (centres[self.sources] - centres[self.targets]).norm(dim=1)
        near = (apart <= radius) | (self.sources == self.targets)
        return self._kept(near, self.sources, self.targets, len(centres))

    def _kept(self, keep: Tensor, sources: Tensor, targets: Tensor, count: int) -> "Neighbours":
        """Some of the pairs; with each its reverse."""
        index = torch.where(keep)[0]
        sources = sources[index]
        return Neighbours(
            sources=sources, targets=targets[index], starts=starts_of(sources, count)
        )  # fmt: skip


def starts_of(sources: Int[Tensor, " e"], count: int) -> Int[Tensor, " n"]:
    """Where the pairs of each source begin.

    Args:
        sources: Ascending, every number below `count` among them.
        count: Number of sources.
    """
    return torch.searchsorted(sources, torch.arange(count, device=sources.device))


def neighbours(centres: Float[Tensor, "n 3"], radius: float) -> Neighbours:
    """All pairs within a radius, found by a k-d tree.

    Args:
        centres: Where the anchors stand.
        radius: In the unit of the centres, >= 0; anchors at exactly it are neighbours.
    """
    count = len(centres)
    points = centres.detach().double().cpu().numpy()
    # A little farther than asked for: what rounding leaves out here, nothing brings back.
    pairs = KDTree(points).query_pairs(radius * (1 + 1e-6), output_type="ndarray")
    found = torch.from_numpy(pairs).to(centres.device).long()
    own = torch.arange(count, device=centres.device)
    one, other = found.unbind(dim=1)
    places = centres.detach()
    near = (places.index_select(0, one) - places.index_select(0, other)).norm(dim=1) <= radius
    one, other = one[near], other[near]
    keys = torch.cat([own * count + own, one * count + other, other * count + one])
    # numpy's sort of plain numbers takes a tenth of torch's, which sorts places along
    keys = torch.from_numpy(np.sort(keys.cpu().numpy())).to(keys)
    sources = keys // max(count, 1)
    return Neighbours(
        sources=sources, targets=keys - sources * count, starts=starts_of(sources, count)
    )  # fmt: skip
