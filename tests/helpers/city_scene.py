"""A tiny scene with tracks, so that it can be cut into blocks."""

from dataclasses import replace

import torch

from helpers.clouds import tracked
from helpers.tiny_scene import tiny_scene
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene


def small_scene(points: int = 300) -> Scene:
    """The tiny scene with tracks: a view sees the points that land in the middle of its image."""
    scene = tiny_scene(views=9, points=points)
    positions = scene.points.positions
    seen = []
    for view in scene.views:
        pixel, _ = project_points(view.camera, positions)
        seen.append((pixel - pixel.new_tensor([12, 9])).abs().amax(dim=1) < 7)
    tracks = [torch.stack(seen)[:, i].nonzero()[:, 0].tolist() for i in range(points)]
    points_seen = replace(tracked(tracks, positions), colours=scene.points.colours)
    return replace(scene, points=points_seen)
