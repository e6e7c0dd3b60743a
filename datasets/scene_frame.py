"""The scene's frame: where its origin is moved to, what is too near to be drawn, and which way is up when nobody says."""

import numpy as np
from jaxtyping import Float64

from splatproof.reference.types.camera import NEAR

FAR_UNITS = 1e4
"""Float32 resolves 1e-3 units at 1e4; farther scenes are moved."""
FAR_EXTENTS = 1e3
NEAR_EXTENTS = 0.01
"""Near plane of a small scene, in its extents."""
LEAST_EXTENT = 1e-6
"""Extent in scene units up to which cameras stand in one place: centres of poses that turn about one point differ by
what rounding leaves."""
_PARALLEL = 0.9
_FLAT = 0.5


def origin_shift(centres: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Vector to subtract from all positions: the cameras' mean where they are far from 0, else 0.

    Far is more than 1e4 units, or more than 1e3 times the scene's extent (the root mean square
    distance of the camera centres from their mean), so that a float32 position keeps at least
    1e-4 of the extent. Ours: spec/00 leaves the rule open.

    Args:
        centres: Camera centres in the original frame.
    """
    mean, extent = centres.mean(0), _extent(centres)
    distance = float(np.linalg.norm(mean))
    far = distance > FAR_UNITS or (extent > 0 and distance > FAR_EXTENTS * extent)
    return mean if far else np.zeros(3)


def near_plane(centres: Float64[np.ndarray, "n 3"]) -> float:
    """Near plane of a scene's cameras in its units: 0.01, and of small scenes 0.01 extents.

    A flight in kilometres, or a model of any small scale, has everything within 0.01 units of its
    cameras, where nothing would be drawn. Ours.

    Args:
        centres: Camera centres; where all are one, to rounding, nothing says how small the scene is.
    """
    extent = _extent(centres)
    return min(NEAR, NEAR_EXTENTS * extent) if extent > LEAST_EXTENT else NEAR


def _extent(centres: Float64[np.ndarray, "n 3"]) -> float:
    """Root mean square distance of the camera centres from their mean."""
    return float(np.sqrt(((centres - centres.mean(0)) ** 2).sum(1).mean()))


def up_vector(
    rotations: Float64[np.ndarray, "n 3 3"], centres: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "3"], str]:
    """Guess the unit vector against gravity from how the photos were taken.

    Nadir flights (all cameras look the same way within about 25 degrees, their centres spread
    at most half as far off a plane as in it, and they look along its normal): the plane's normal, on the side away from what
    they look at. A flat survey of a facade meets the same conditions and is taken for one.
    Otherwise the mean of the cameras' up axes (-y), which people and gimbals keep upright.

    Args:
        rotations: World to camera.
        centres: Camera centres.

    Returns: The vector and the rule that gave it ("camera plane" or "camera axes").
    """
    forward = rotations[:, 2].mean(0)
    if len(centres) >= 3:
        _, spread, axes = np.linalg.svd(centres - centres.mean(0), full_matrices=False)
        normal = axes[2] * (-1 if axes[2] @ forward > 0 else 1)
        flat = spread[1] > 0 and spread[2] < _FLAT * spread[1]
        if flat and np.linalg.norm(forward) > _PARALLEL and -normal @ forward > _PARALLEL:
            return normal, "camera plane"
    mean = -rotations[:, 1].mean(0)
    length = np.linalg.norm(mean)
    if length < 1e-6:  # the cameras' ups cancel: any choice is as good, keep COLMAP's -y
        return np.array([0.0, -1.0, 0.0]), "camera axes"
    return mean / length, "camera axes"
