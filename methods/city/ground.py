"""A scene as partitions see it: upright, along the flight, with the load of each sparse point."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.partition.ground_frame import ground_frame
from splatproof.reference.partition.visibility import track_lengths
from splatproof.reference.types.scene import Scene

VOXELS_ALONG = 64
"""Voxels along the longer side of the middle 98 % of the points, unless a size is given."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """A scene as partitions see it: in the upright frame that follows the flight."""

    scene: Scene
    frame: Float64[Tensor, "3 3"]
    """Rotation from the scene into this frame; its rows are x, y along the ground, and up."""
    positions: Float64[Tensor, "n 3"]
    """Sparse points in this frame, in scene units."""
    loads: Int64[Tensor, " n"]
    """Track length of each sparse point: number of views that see it."""
    voxel_size: float
    """Side of a voxel in scene units."""
    trained: Bool[Tensor, " v"]
    """Which views a method may train on."""


def ground(scene: Scene, voxel_size: float | None = None) -> Ground:
    """Turn the scene upright and choose the voxel size, if none is given.

    Args:
        scene: With sparse points, their tracks, and training views, whose flight the x axis
            follows.
        voxel_size: Side of a voxel in scene units, > 0; None: a 64th of the longer side, on the
            ground, of the middle 98 % of the points.

    Raises: DataError for a scene without training views or sparse points.
    """
    if not scene.train or len(scene.points) == 0:
        raise DataError(
            f"scene {scene.name!r}: {len(scene.train)} training views and {len(scene.points)} "
            "sparse points; a partition needs at least one of each"
        )
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    frame = ground_frame(scene.up, centres)
    positions = scene.points.positions @ frame.T
    if voxel_size is None:
        low, high = np.quantile(positions[:, :2].numpy(), [0.01, 0.99], axis=0)
        voxel_size = float((high - low).max()) / VOXELS_ALONG or 1.0
    trained = torch.zeros(len(scene.views), dtype=torch.bool)
    trained[list(scene.train)] = True
    return Ground(
        scene=scene, frame=frame, positions=positions, voxel_size=voxel_size, trained=trained,
        loads=track_lengths(scene.points).long(),
    )  # fmt: skip
