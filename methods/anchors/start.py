"""Anchors from structure-from-motion points: how large a voxel is, and what an anchor starts as."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.initialise import extent, neighbour_distance, require_points
from splatproof.reference.anchors import scaffold
from splatproof.reference.types.scene import Scene

VoxelRule = Literal["distance", "squared"]
"""Length that a voxel is made of where none is given: the median spacing of the points divided by
the cells of the coarsest level, so that one of its cells is as wide as points are apart; or, as in
the release of Scaffold-GS, the median of the squared spacing taken for a length (another model in
other units)."""


def voxel_size(scene: Scene, rule: VoxelRule, coarsest: int) -> float:
    """Edge of a voxel in scene units, from how far the points are apart.

    Args:
        scene: With sparse points.
        rule: How.
        coarsest: Edge of the coarsest cells of growing, in voxels.

    Raises: DataError if there is no point or no training view.

    Source: "squared", the release of Scaffold-GS; "distance", ours.
    """
    require_points(scene)
    apart = neighbour_distance(scene.points.positions, lone=0.01 * extent(scene))
    if rule == "squared":
        return float(apart.square().median())
    return float(apart.median()) / coarsest


def started(
    scene: Scene,
    *,
    voxel: float,
    k: int,
    features: int,
    shared: dict[str, Tensor],
    moving: bool = False,
) -> Parameters:
    """One anchor in each voxel that holds a point: zero features and offsets, scales by neighbours.

    Args:
        scene: With sparse points.
        voxel: Edge of a voxel in scene units, > 0.
        k: Gaussians an anchor.
        features: Numbers of an anchor's feature.
        shared: Tensors of the networks.
        moving: Whether centres are trained: then they are rows, else labels.

    Raises: DataError if there is no point or no training view.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.1 and its release.
    """
    require_points(scene)
    centres = scaffold.anchor_voxels(scene.points.positions.double(), voxel)
    apart = neighbour_distance(centres, lone=0.01 * extent(scene))
    count = len(centres)
    rows = {
        "offsets": torch.zeros(count, k, 3),
        "features": torch.zeros(count, features),
        "log_scales": apart.log().float()[:, None].repeat(1, 6),
    }
    labels = {"levels": torch.full((count,), -1)}
    (rows if moving else labels)["centres"] = centres.float()
    return Parameters(rows, shared=shared, labels=labels)


def centres_of(parameters: Parameters) -> Float[Tensor, "n 3"]:
    """Where the anchors of a model stand: a trained row where they move, a label where they do not."""
    rows = parameters.rows
    return rows["centres"] if "centres" in rows else parameters.labels["centres"]
