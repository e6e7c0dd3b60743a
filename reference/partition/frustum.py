"""How much of an image a box fills, wherever the camera stands, inside the box included."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from splatproof.reference.partition.boxes import OrientedBox, corners
from splatproof.reference.types.camera import Camera, transform_points

FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corner indices around each face of a box (bit j of an index: positive end of axis j)."""


def image_share(camera: Camera, box: OrientedBox) -> float:
    """Share in [0, 1] of the image that the box's projection covers.

    The faces are cut by the frustum in camera space, before the projection: a corner behind the
    camera never mirrors to the front. The projection of a convex body is the hull of its corners,
    so the hull of what is left of the faces is the box's silhouette within the image.

    Args:
        camera: The pinhole camera; its image and near plane bound what is seen.
        box: The box in the world, scene units.

    Source: VastGaussian, Sec. 4.1 (visibility by projected area).
    """
    world = corners(box)
    cam = transform_points(camera, world).numpy()
    left = [clip(cam[list(face)], frustum(camera)) for face in FACES]
    points = np.concatenate(left)
    pixels = points @ camera.K.to(world).numpy().T
    return hull_area(pixels[:, :2] / pixels[:, 2:]) / (camera.width * camera.height)


def frustum(camera: Camera) -> Float[np.ndarray, "5 4"]:
    """Half-spaces n . x + d >= 0 of camera space: in front of near, and within the four borders."""
    k = camera.K.double().numpy()
    left, top = k[0], k[1]  # x_pixel z = k[0] . x, and the same for y
    right = np.array([0, 0, camera.width]) - k[0]
    bottom = np.array([0, 0, camera.height]) - k[1]
    sides = np.column_stack([[left, right, top, bottom], np.zeros(4)])
    return np.concatenate([[[0.0, 0.0, 1.0, -camera.near]], sides])


def clip(
    polygon: Float[np.ndarray, "c 3"], planes: Float[np.ndarray, "p 4"]
) -> Float[np.ndarray, "k 3"]:
    """Corners of a convex polygon's part inside all half-spaces n . x + d >= 0.

    Args:
        polygon: Corners in order around a convex polygon.
        planes: Rows (n, d) of the half-spaces, in the polygon's frame.

    Returns: Corners in the same order; none where nothing is inside.

    Source: Sutherland and Hodgman 1974, "Reentrant Polygon Clipping".
    """
    for plane in planes:
        height = polygon @ plane[:3] + plane[3]
        kept = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if height[i] >= 0:
                kept.append(polygon[i])
            if (height[i] >= 0) != (height[j] >= 0):
                share = height[i] / (height[i] - height[j])
                kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
        polygon = np.array(kept).reshape(-1, 3)
    return polygon


def hull_area(points: Float[np.ndarray, "n 2"]) -> float:
    """Area of the convex hull; 0 for fewer than three points or for points on one line."""
    try:
        return float(ConvexHull(points).volume) if len(points) > 2 else 0.0
    except QhullError:  # flat input
        return 0.0
