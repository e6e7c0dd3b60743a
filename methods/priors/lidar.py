"""Prior `lidar`: what the view's sweep hit, seen from its camera and filled in between."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter
from scipy.spatial import Delaunay, QhullError

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior, Scene, Sweep

LONGEST = 4.0
"""Longest edge of a triangle that is filled, in median edges."""
JUMP = 1.3
"""Ratio of disparities up to which neighbouring hits are on one surface."""
AROUND = 5
"""Edge in pixels of the square in which a hit hides those far behind it."""


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene; one without a sweep says nothing.

    Args:
        scene: A scene of which at least one training view has a sweep.
        weights: None; it has none.
        seed: Not used; it draws nothing.
    Raises: UsageError where no training view has a sweep.
    """
    if all(view.load_sweep is None for view in scene.train_views):
        raise UsageError(
            f"{scene.name}: no training view has a LiDAR sweep, which depth prior 'lidar' is made of; "
            "'sweep' is made of the photos alone"
        )

    def make(index: int) -> DepthPrior:
        view = scene.views[index]
        if view.load_sweep is None:
            nothing = torch.zeros(view.size)
            return DepthPrior(disparity=nothing, valid=nothing > 0)
        return completed(view.camera, view.load_sweep())

    return make


def completed(camera: Camera, sweep: Sweep) -> DepthPrior:
    """Disparity 1 / z of the hits, linear between them; valid where hits lie close on one surface.

    A plane is linear in disparity over the image, so it comes back as it is. The sensor stands
    elsewhere than the camera: hits behind much nearer ones are hidden and left out.

    Args:
        camera: Camera of the view.
        sweep: The sweep of its moment.
    Source: triangulation and interpolation: SciPy (Qhull); what is hidden and filled: ours.
    """
    from scipy.interpolate import LinearNDInterpolator  # slow to import, and few scenes have sweeps

    pixels, disparity = visible(camera, sweep)
    height, width = camera.height, camera.width
    filled, valid = np.zeros((height, width)), np.zeros((height, width), bool)
    mesh = _mesh(pixels)
    if mesh is not None:
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        at = np.stack([columns, rows], axis=-1)
        inside = mesh.find_simplex(at)
        valid = (inside >= 0) & _surfaces(mesh, disparity)[inside]
        filled[valid] = LinearNDInterpolator(mesh, disparity)(at[valid])
    return DepthPrior(disparity=torch.from_numpy(filled).float(), valid=torch.from_numpy(valid))


def visible(
    camera: Camera, sweep: Sweep
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Pixel positions and disparities of the hits that the camera sees, at most one a pixel.

    Args:
        camera: Camera of the view.
        sweep: The sweep of its moment.
    """
    at, z = project_points(camera, sweep.positions.double())
    size = at.new_tensor([camera.width, camera.height])
    drawn = (z > camera.near) & (at >= 0).all(dim=1) & (at < size).all(dim=1)
    pixels, disparity = at[drawn].numpy(), 1 / z[drawn].numpy()
    order = np.argsort(disparity, kind="stable")
    pixels, disparity = pixels[order], disparity[order]
    column, row = pixels.astype(int).T
    nearest = np.zeros((camera.height, camera.width))
    owner = np.full(nearest.shape, -1)
    nearest[row, column], owner[row, column] = (
        disparity,
        np.arange(len(order)),
    )  # the last one stays
    hidden = nearest * JUMP < maximum_filter(nearest, size=AROUND)
    kept = owner[(owner >= 0) & ~hidden]
    return pixels[kept], disparity[kept]


def _mesh(pixels: Float[np.ndarray, "n 2"]) -> Delaunay | None:
    """Triangles between the pixels; None where they make none: too few, or all on a line."""
    try:
        return Delaunay(pixels) if len(pixels) >= 3 else None
    except QhullError:
        return None


def _surfaces(mesh: Delaunay, disparity: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " m"]:
    """Which triangles are small and lie on one surface."""
    corners, values = mesh.points[mesh.simplices], disparity[mesh.simplices]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    small = edges.max(axis=1) <= LONGEST * np.median(edges)
    return small & (values.max(axis=1) <= JUMP * values.min(axis=1))
