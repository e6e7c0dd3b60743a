"""A tiny scene with true depth and LiDAR: a slanted plane, in front of it a nearer square."""

from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from helpers.tiny_scene import tiny_scene
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, Sweep, View


def plane_depth(camera: Camera) -> Float[Tensor, "h w"]:
    """z-depth of a wall that recedes to the right and upwards, sky above it."""
    row, column = torch.meshgrid(
        torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
    )
    disparity = 0.2 + 0.004 * row - 0.001 * column
    depth = (1 / disparity).float()
    depth[:2] = torch.inf
    return depth


def sweep_of(camera: Camera, depth: Float[Tensor, "h w"], step: int = 2) -> Sweep:
    """Hits at every step-th pixel that has depth, from the camera's own place."""
    row, column = (depth.isfinite()).nonzero(as_tuple=True)
    kept = (row % step == 0) & (column % step == 0)
    row, column = row[kept], column[kept]
    z = depth[row, column].double()
    pixel = torch.stack([column + 0.5, row + 0.5, torch.ones_like(row)], dim=1).double()
    local = (torch.linalg.inv(camera.K) @ pixel.T).T * z[:, None]
    world = (local - camera.translation) @ camera.rotation
    return Sweep(positions=world.float(), origin=camera.centre)


def known(view: View, *, sweep: bool = True) -> View:
    """The view with true depth and, unless it is to have none, a sweep."""
    depth = plane_depth(view.camera)
    return replace(
        view,
        load_depth=depth.clone,
        load_sweep=partial(sweep_of, view.camera, depth) if sweep else None,
    )


def plane_scene(*, sweep: bool = True) -> Scene:
    """Four training views (1, 2, 4, 5) and two held-out ones (0, 3), all of them with truth."""
    scene = tiny_scene(points=12)
    views = tuple(known(view, sweep=sweep) for view in scene.views)
    return replace(scene, views=views, train=(1, 2, 4, 5), test=(0, 3))
