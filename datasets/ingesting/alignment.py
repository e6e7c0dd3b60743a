"""The photos' GPS takes a model from its own frame to metres east, north and up."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from splatproof.datasets.colmap_library import pycolmap
from splatproof.datasets.scene_frame import up_vector

TILT = math.radians(1.0)
"""Largest standard error of the vertical that altitudes may leave."""
DISAGREEMENT = math.radians(10.0)
"""Largest angle between the vertical by GPS and the normal of a nadir flight's plane."""
STRETCH = 0.02
"""Largest standard error of the scale."""
_RANSAC_METRES = (2.0, 5.0, 10.0, 20.0)
_MOST = 0.7


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """A similarity from the model's frame to local metres, and how well it fits."""

    transform: pycolmap.Sim3d
    how: str
    """"positions and altitudes" or "positions, levelled by the camera plane"."""
    residuals: Float64[np.ndarray, " n"]
    """Metres between each camera and its GPS position, in the plane where altitudes are not
    used, else in space."""


def local_metres(gps: Float64[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """(east, north, up) of each GPS position and the origin (latitude, longitude, altitude).

    The origin is the median of the positions; unknown altitudes stay nan.
    """
    known = np.isfinite(gps[:, 2])
    origin = np.median(gps, axis=0)
    origin[2] = np.median(gps[known, 2]) if known.any() else 0.0
    filled = np.where(
        known[:, None], gps, np.column_stack([gps[:, :2], np.full(len(gps), origin[2])])
    )
    metres = np.array(pycolmap.GPSTransform().ellipsoid_to_enu(filled, *origin))
    metres[~known, 2] = math.nan
    return metres, origin


def align(
    rotations: Float64[np.ndarray, "n 3 3"],
    centres: Float64[np.ndarray, "n 3"],
    metres: Float64[np.ndarray, "n 3"],
    seed: int,
) -> Alignment | str:
    """Fit x_metres = s R x + t to the camera centres.

    First in space, robustly. Where altitudes would tilt the scene (a standard error above
    1 degree, or 10 degrees away from the plane of a nadir flight: cheap receivers drift by
    100 m) only the positions on the map are used, and the camera plane is made level.

    Args:
        rotations: World to camera of the registered photos with GPS.
        centres: Camera centres of these photos, in the model's frame.
        metres: GPS positions of these photos from `local_metres`; altitudes may be nan.
        seed: Decides which samples RANSAC draws.

    Returns: The alignment, or in words why there is none.
    """
    if len(centres) < 3:
        return f"{len(centres)} registered photos have GPS, at least 3 are needed"
    spread = np.linalg.svd(metres[:, :2] - metres[:, :2].mean(0), compute_uv=False)
    if spread[1] < 0.02 * spread[0] or spread[0] == 0:
        return "the GPS positions lie on one line"
    up, source = up_vector(rotations, centres)
    plane = up if source == "camera plane" else None
    found = _in_space(centres, metres, seed)
    if found is not None and _trusted(found, plane, centres):
        return found
    if plane is None:
        return "GPS altitudes do not fit the cameras, and these do not look straight down"
    found = _on_the_map(plane, centres, metres)
    # least squares: sigma an axis over the root of the summed squares of both axes
    error = _rms(found.residuals) / math.sqrt(2) / float(np.linalg.norm(spread))
    if error > STRETCH:
        return f"GPS positions leave the scale uncertain by {100 * error:.0f} %"
    return found


def _rms(residuals: np.ndarray) -> float:
    return float(np.sqrt((residuals**2).mean()))


def _in_space(centres: np.ndarray, metres: np.ndarray, seed: int) -> Alignment | None:
    """Robust similarity over the positions with altitude, at the smallest threshold that most fit."""
    known = np.isfinite(metres[:, 2])
    if known.sum() < 3:
        return None
    options = pycolmap.RANSACOptions()
    options.random_seed = seed
    for limit in _RANSAC_METRES:
        options.max_error = limit
        # a dict with the inliers, although pycolmap's stub says Sim3d
        found: Any = pycolmap.estimate_sim3d_robust(centres[known], metres[known], options)
        if found is None:
            continue
        inliers = np.asarray(found["inlier_mask"])
        if inliers.mean() >= _MOST and inliers.sum() >= 3:
            fine = pycolmap.estimate_sim3d(centres[known][inliers], metres[known][inliers])
            if fine is not None:
                moved = np.array([fine * centre for centre in centres[known]])
                return Alignment(
                    transform=fine,
                    how="positions and altitudes",
                    residuals=np.linalg.norm(moved - metres[known], axis=1),
                )
    return None


def _trusted(found: Alignment, plane: np.ndarray | None, centres: np.ndarray) -> bool:
    """Whether the vertical of a fit in space can be believed."""
    # least squares: the tilt about the long axis has a standard error of sigma / (spread across)
    across = found.transform.scale * np.linalg.svd(centres - centres.mean(0), compute_uv=False)[1]
    if np.median(found.residuals) / across > TILT:
        return False
    vertical = found.transform.rotation.matrix()[2]
    return plane is None or math.acos(min(1.0, float(vertical @ plane))) < DISAGREEMENT


def _on_the_map(up: np.ndarray, centres: np.ndarray, metres: np.ndarray) -> Alignment:
    """Level the frame, then fit w = a z + b over complex map positions, robustly reweighted."""
    helper = np.eye(3)[np.argmin(np.abs(up))]
    east = np.cross(helper, up)
    east /= np.linalg.norm(east)
    level = np.stack([east, np.cross(up, east), up])
    flat = centres @ level.T
    z, w = flat[:, 0] + 1j * flat[:, 1], metres[:, 0] + 1j * metres[:, 1]
    weight = np.ones(len(z))
    a, b, residuals = 0j, 0j, np.zeros(len(z))
    for _ in range(20):  # Huber weights at three median residuals; settles in a few rounds
        weight /= weight.sum()
        z0, w0 = weight @ z, weight @ w
        a = (weight @ (np.conj(z - z0) * (w - w0))) / (weight @ np.abs(z - z0) ** 2)
        b = w0 - a * z0
        residuals = np.abs(a * z + b - w)
        limit = 3 * max(float(np.median(residuals)), 1e-9)
        weight = np.minimum(1.0, limit / np.maximum(residuals, limit))
    scale, angle = abs(a), np.angle(a)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]]
    )
    altitudes = metres[:, 2] - scale * flat[:, 2]
    height = float(np.nanmedian(altitudes)) if np.isfinite(altitudes).any() else 0.0
    return Alignment(
        transform=pycolmap.Sim3d(
            scale, pycolmap.Rotation3d(turn @ level), np.array([b.real, b.imag, height])
        ),
        how="positions, levelled by the camera plane",
        residuals=residuals,
    )
