"""How many of a scene's points a training view shows: what decoding a view costs goes by them."""

import statistics

import torch

from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene

VIEWS, POINTS = 50, 10_000
"""Most views and points that are looked at, evenly spread."""


def share_in_view(scene: Scene) -> float:
    """Mean share of the sparse points that lie in a training view's image; 1 where there are none.

    Args:
        scene: No image is read.
    """
    positions = scene.points.positions[:: 1 + len(scene.points) // POINTS]
    views = scene.train_views[:: 1 + len(scene.train_views) // VIEWS]
    if not len(positions):
        return 1.0
    shares = []
    for camera in (view.camera for view in views):
        pixels, depth = project_points(camera, positions)
        size = torch.tensor([camera.width, camera.height]).to(pixels)
        inside = ((pixels >= 0) & (pixels < size)).all(dim=1) & (depth > camera.near)
        shares.append(float(inside.double().mean()))
    return statistics.fmean(shares)
