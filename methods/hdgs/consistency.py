"""Inter-anchor consistency (ICE): anchors of neighbouring voxels support one another's features."""

import itertools
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.kernels import support as native
from splatproof.reference.anchors.sparse_convolution import OFFSETS, voxelise
from splatproof.reference.anchors.support_network import SupportNetwork
from splatproof.reference.rasterizer import rotation
from splatproof.reference.types import mlp

Ice = Literal["off", "conv", "no-mod", "no-gate", "full"]
"""Which parts of the step run: none; the convolution and its residual alone; with the gate but not
modulated; modulated but without the gate; all of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """Which sites stand in one another's 3 x 3 x 3 voxels, themselves included."""

    sites: Int[Tensor, " p"]
    """Row of the site that receives, cell by cell of the kernel."""
    neighbours: Int[Tensor, " p"]
    """Row of the site that gives."""
    ends: tuple[int, ...]
    """Where the pairs of each of the 27 kernel cells end."""

    def of(self, wanted: Bool[Tensor, " n"]) -> "Pairs":
        """The pairs whose receiving site is wanted.

        Args:
            wanted: Which of all sites are.
        """
        keep = wanted[self.sites]
        before = torch.nn.functional.pad(keep.cumsum(0), (1, 0))
        ends = before[torch.tensor(self.ends, device=keep.device)].tolist()
        return Pairs(sites=self.sites[keep], neighbours=self.neighbours[keep], ends=tuple(ends))


def pairs(centres: Float[Tensor, "n 3"], voxel: float) -> Pairs:
    """All pairs of neighbours, found by sorting the voxels' numbers.

    Twin of `sparse_convolution.neighbours`, without its loop over sites.

    Args:
        centres: At most one a voxel, scene units.
        voxel: Edge of the voxels in scene units, > 0.

    Raises: ValueError if two sites share a voxel.
    """
    cells = voxelise(centres, voxel)
    if len(cells) == 0:
        return Pairs(sites=cells[:, 0], neighbours=cells[:, 0], ends=(0,) * len(OFFSETS))
    cells = cells - cells.amin(dim=0) + 1
    _, rows, depth = (cells.amax(dim=0) + 2).tolist()  # a border: no step leaves its row
    keys = (cells[:, 0] * rows + cells[:, 1]) * depth + cells[:, 2]
    ordered, order = keys.sort()
    if (ordered[1:] == ordered[:-1]).any():
        raise ValueError("two sites share a voxel: merge them first")
    sites, neighbours = [], []
    for dx, dy, dz in OFFSETS:
        wanted = keys + (dx * rows + dy) * depth + dz
        place = torch.searchsorted(ordered, wanted).clamp(max=len(keys) - 1)
        (found,) = torch.where(ordered[place] == wanted)
        sites.append(found)
        neighbours.append(order[place[found]])
    ends = torch.tensor([len(part) for part in sites]).cumsum(0).tolist()
    return Pairs(sites=torch.cat(sites), neighbours=torch.cat(neighbours), ends=tuple(ends))


def supported(
    network: SupportNetwork,
    features: Float[Tensor, "n c"],
    centres: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    near: Pairs,
    seen: Int[Tensor, " v"],
    ice: Ice = "full",
) -> Float[Tensor, "v c"]:
    """Features of some anchors after the step: f + g(f_mod) Linear(f_mod), by the kernels where they can.

    Twin of `support_network.support`: only pairs that exist are computed.

    Args:
        network: Parameters of the step.
        features: Features of all anchors.
        centres: Positions of all anchors, in one unit with the voxels.
        quaternions: Orientation (w, x, y, z) of each anchor's base covariance, any norm.
        scales: Standard deviations of the base covariance, > 0.
        near: From `pairs`, of all anchors.
        seen: Rows of the anchors whose features are asked for.
        ice: Which parts of the step run.

    Source: HDGS, Eqs. 7 and 8.
    """
    if ice == "off":
        return features[seen]
    if native.applies(network, features, centres, quaternions, scales):
        return native.support(
            network, features, centres, quaternions, scales,
            (near.sites, near.neighbours, near.ends), seen,
            modulated=ice in ("full", "no-gate"), gated=ice in ("full", "no-mod"),
        )  # fmt: skip
    wanted = torch.zeros(len(features), dtype=torch.bool, device=features.device)
    wanted[seen] = True
    near = near.of(wanted)
    return supported_by_products(network, features, centres, quaternions, scales, near, seen, ice)


def supported_by_products(
    network: SupportNetwork,
    features: Float[Tensor, "n c"],
    centres: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    near: Pairs,
    seen: Int[Tensor, " v"],
    ice: Ice,
) -> Float[Tensor, "v c"]:
    """The same with one matrix product a kernel cell, for any dtype and device.

    Args:
        network: As for `supported`, like all but `near` and `ice`.
        features: Features of all anchors.
        centres: Positions of all anchors.
        quaternions: Orientation of each anchor's base covariance.
        scales: Standard deviations of the base covariance.
        near: Pairs whose receiving site is seen.
        seen: Rows of the anchors whose features are asked for.
        ice: Any but "off".
    """
    own, count = features[seen], len(features)
    counts = [end - start for start, end in itertools.pairwise((0, *near.ends))]
    given = features.index_select(0, near.neighbours).split(counts)  # its gradient is one copy
    added = torch.cat(
        [part @ weight for part, weight in zip(given, network.convolution.unbind(), strict=True)]
    )
    place = torch.empty(count, dtype=torch.long, device=features.device)
    place[seen] = torch.arange(len(seen), device=features.device)
    receives = place[near.sites]
    if ice in ("full", "no-gate"):
        offsets = centres[near.neighbours] - centres[near.sites]
        code = directions(offsets, quaternions[seen], scales[seen], receives)
        added = added * mlp.evaluate(network.modulation, code)
    mixed = torch.zeros_like(own).index_add(0, receives, added)
    change = mlp.evaluate(network.residual, mixed)
    if ice in ("full", "no-mod"):
        change = torch.sigmoid(mlp.evaluate(network.gate, mixed)) * change
    return own + change


def directions(
    offsets: Float[Tensor, "p 3"],
    quaternions: Float[Tensor, "v 4"],
    scales: Float[Tensor, "v 3"],
    receives: Int[Tensor, " p"],
) -> Float[Tensor, "p 4"]:
    """What modulates each pair: how well it lies along the site's axis, and the eigenvalues' shares.

    Twin of `support_network.alignment`.

    Args:
        offsets: From the receiving site to the giving one.
        quaternions: Orientation of each receiving site's base covariance.
        scales: Standard deviations of the base covariance, > 0.
        receives: Which of these sites receives, a number a pair.
    """
    values = descending(scales.square())
    rows = torch.arange(len(scales), device=scales.device)
    axes = rotation.rotation_matrix(quaternions)[rows, :, scales.argmax(dim=1)]
    # A disc or a sphere has no axis: its direction fades out.
    unique = 1 - values[:, 1:2] / values[:, :1]
    told = torch.cat([axes, unique, values / values.sum(dim=1, keepdim=True)], dim=1)
    mine = told.index_select(0, receives)
    apart = offsets.square().sum(dim=1)
    cosine = (offsets * mine[:, :3]).sum(dim=1).square() / torch.where(apart > 0, apart, 1)
    return torch.cat([(cosine * mine[:, 3])[:, None], mine[:, 4:]], dim=1)


def descending(values: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3"]:
    """Each row's three values, largest first (sorting rows of three takes ten times as long)."""
    a, b, c = values.unbind(dim=1)
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    middle = torch.maximum(low, torch.minimum(high, c))
    return torch.stack([torch.maximum(high, c), middle, torch.minimum(low, c)], dim=1)
