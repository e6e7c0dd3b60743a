"""The surface that a view shows, known before anything is trained: true depth or sparse points."""

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import QhullError
from torch import Tensor

from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene

LEAST_POINTS = 16
"""With fewer observed points a view takes all points that lie in its image."""


def surface_depth(scene: Scene, index: int) -> Float[Tensor, "h w"]:
    """z-depth of a view's surface: the truth where the scene has it, else from its sparse points.

    Between the points that the view observes, 1/z is interpolated linearly over the image's
    Delaunay triangles, which is exact on planes; beyond them the nearest point's depth is taken.
    No trained model takes part, so that all of them are asked about the same surface.

    Args:
        scene: The scene, with sparse points where the view has no true depth.
        index: Index of the view in scene.views.
    Returns: Depth in scene units; inf where nothing is hit, and everywhere if no point is in the
        image.
    Source: ours.
    """
    view = scene.views[index]
    if view.load_depth is not None:
        return view.load_depth()
    pixels, depths = _observed(scene, index)
    size = (view.camera.height, view.camera.width)
    if len(pixels) == 0:
        return torch.full(size, torch.inf)
    y, x = np.mgrid[0 : size[0], 0 : size[1]] + 0.5
    inverse = NearestNDInterpolator(pixels, 1 / depths)(x, y)
    try:
        inside = LinearNDInterpolator(pixels, 1 / depths)(x, y)
        inverse = np.where(np.isfinite(inside), inside, inverse)
    except QhullError:
        pass  # fewer than three points, or all on a line: there is no triangle
    return torch.from_numpy(1 / inverse).float()


def _observed(scene: Scene, index: int) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Pixels and depths of the points that a view observes, or of all in its image if too few."""
    points, camera = scene.points, scene.views[index].camera
    lengths = points.track_starts.diff()
    owners = torch.repeat_interleave(torch.arange(len(points)), lengths)
    rows = owners[points.track_views == index]
    if len(rows) < LEAST_POINTS:
        rows = torch.arange(len(points))
    pixels, depths = project_points(camera, points.positions[rows])
    size = torch.tensor([camera.width, camera.height])
    kept = (depths > camera.near) & ((pixels >= 0) & (pixels < size)).all(dim=1)
    return pixels[kept].numpy(), depths[kept].numpy()
