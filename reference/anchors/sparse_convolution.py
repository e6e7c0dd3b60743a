"""Submanifold sparse convolution: a 3 x 3 x 3 kernel over occupied voxels only."""

import itertools

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.reference.types.cells import unique_rows

OFFSETS = tuple(itertools.product((-1, 0, 1), repeat=3))
"""Kernel cells in the order of their weights: x slowest, z fastest; number 13 is the centre."""
SELF = 13


def voxelise(positions: Float[Tensor, "n 3"], size: float) -> Int[Tensor, "n 3"]:
    """Voxel of each position, by rounding down; any sign.

    Args:
        positions: Positions in scene units.
        size: Edge of a voxel in scene units, > 0.

    Raises: ValueError if the size is not positive.
    """
    if not size > 0:
        raise ValueError(f"voxel size must be positive: {size}")
    return (positions / size).floor().long()


def neighbours(sites: Int[Tensor, "n 3"]) -> Int[Tensor, "n 27"]:
    """Index of the site at each of the 27 kernel cells around each site; -1 where there is none.

    Raises: ValueError if two sites share a voxel.
    """
    if len(sites) and len(unique_rows(sites)[0]) < len(sites):
        raise ValueError("two sites share a voxel: merge them first")
    index = {tuple(site): i for i, site in enumerate(sites.tolist())}
    found = [
        [index.get((x + dx, y + dy, z + dz), -1) for dx, dy, dz in OFFSETS]
        for x, y, z in sites.tolist()
    ]
    return torch.tensor(found, dtype=torch.long).reshape(-1, len(OFFSETS))


def contributions(
    features: Float[Tensor, "n c"],
    around: Int[Tensor, "n 27"],
    weights: Float[Tensor, "27 c d"],
) -> Float[Tensor, "n 27 d"]:
    """What each neighbour adds to each site, W_o f_j; zero where there is no neighbour.

    Args:
        features: One row a site.
        around: Index of each site's 27 neighbours, -1 for none, from `neighbours`.
        weights: One matrix W_o a kernel cell, in the order of OFFSETS.

    Source: Graham et al. 2018, "3D Semantic Segmentation with Submanifold Sparse Convolutional
        Networks", Sec. 3.
    """
    gathered = torch.where((around >= 0)[..., None], features[around.clamp(min=0)], 0)
    return torch.einsum("noc,ocd->nod", gathered, weights)


def convolve(
    features: Float[Tensor, "n c"],
    around: Int[Tensor, "n 27"],
    weights: Float[Tensor, "27 c d"],
) -> Float[Tensor, "n d"]:
    """Submanifold convolution: the sites that come out are the sites that went in.

    Args:
        features: One row a site.
        around: Index of each site's 27 neighbours, -1 for none, from `neighbours`.
        weights: One matrix W_o a kernel cell, in the order of OFFSETS.
    """
    return contributions(features, around, weights).sum(dim=1)
