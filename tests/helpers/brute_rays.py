"""What cameras see of a point, from every triangle in float64: an oracle without a ray tracer."""

import numpy as np

SLACK = 0.02
"""Metres before a point in which an obstacle does not count (Caster.visible)."""


def crossed(triangles, start, end):
    """Whether any triangle crosses the segment (Moller and Trumbore 1997)."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    near = ((triangles.max(axis=1) >= low) & (triangles.min(axis=1) <= high)).all(axis=1)
    corner, first, second = triangles[near].transpose(1, 0, 2)
    first, second, way = first - corner, second - corner, end - start
    p = np.cross(way, second)
    scale = np.einsum("ij,ij->i", first, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - corner
        u = np.einsum("ij,ij->i", offset, p) / scale
        q = np.cross(offset, first)
        v = q @ way / scale
        t = np.einsum("ij,ij->i", second, q) / scale
        return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any())


def views_of(world, point, normal, cameras, steep):
    """Which cameras have a point in the image, not too steeply, with nothing before it."""
    triangles = world.vertices[world.faces]
    found = []
    for camera in cameras:
        eye = camera.centre.numpy()
        pose = camera.world_to_camera.numpy()
        x, y, z = pose[:3, :3] @ point + pose[:3, 3]
        if z <= camera.near:
            found.append(False)
            continue
        K = camera.K.numpy()
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        way = eye - point
        length = np.linalg.norm(way)
        inside = 0 <= u < camera.width and 0 <= v < camera.height
        if inside and abs(way @ normal) > steep * length:
            found.append(not crossed(triangles, eye, point + way / length * SLACK))
        else:
            found.append(False)
    return np.array(found, dtype=bool)
