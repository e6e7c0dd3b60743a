"""Cameras: where a flight, a drive or a walk takes its pictures from."""

import numpy as np
import torch
from jaxtyping import Float

from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.vectors import norm
from splatproof.reference.types.camera import Camera


def looking(
    eye: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
    size: tuple[int, int],
    focal: Number,
) -> Camera:
    """A pinhole camera at `eye` towards `target`, upright where that is defined.

    Args:
        eye: Position in metres.
        target: Point that falls on the image's centre.
        size: Width and height in pixels.
        focal: Focal length in pixels.
    """
    forward = (target - eye) / norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= norm(right)
    return _posed(eye, np.stack([right, np.cross(forward, right), forward]), size, focal)


def _posed(
    eye: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    focal: Number,
) -> Camera:
    """A pinhole camera at `eye`; rows of `rotation` are its right, down and forward in the world."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ eye
    width, height = size
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(
        K=torch.from_numpy(intrinsics), world_to_camera=torch.from_numpy(pose),
        width=width, height=height,
    )  # fmt: skip


def ring(
    count: int, radius: Number, altitude: Number, target: Float[np.ndarray, "3"], phase: Number,
    jitter: Number, rng: np.random.Generator,
) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:  # fmt: skip
    """Eyes on a circle around a target, each a little off.

    Args:
        count: Number of views.
        radius: Metres from the target, on the map.
        altitude: Metres above the target.
        target: What is looked at, in metres.
        phase: Angle of the first eye, in radians counter-clockwise from +x.
        jitter: Standard deviation of eyes and targets on each axis, in metres.
        rng: Draws the jitter.
    Returns: (eye, place that it looks at) of each view.
    """
    views = []
    for index in range(count):
        angle = phase + 2 * np.pi * index / count
        eye = target + np.array([radius * np.cos(angle), radius * np.sin(angle), altitude])
        views.append((eye + rng.normal(0, jitter, 3), target + rng.normal(0, jitter, 3)))
    return views


def strips(
    x: tuple[float, float, int], y: tuple[float, float, int], altitude: Number, tilt: Number,
    jitter: Number, rng: np.random.Generator,
) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:  # fmt: skip
    """Eyes on a serpentine of straight lines along x, looking down.

    Args:
        x: First and last station of a line in metres, and how many there are.
        y: First and last line in metres, and how many there are.
        altitude: Height of the stations in metres.
        tilt: Forward slope of the view, tangent of the angle from straight down.
        jitter: Standard deviation of positions, metres.
        rng: Draws the jitter.
    Returns: (eye, place that it looks at) of each view.
    """
    views = []
    for line, y_line in enumerate(np.linspace(*y)):
        stations = np.linspace(*x)
        ahead = 1.0 if line % 2 == 0 else -1.0
        for station in stations[:: int(ahead)]:
            eye = np.array([station, y_line, altitude]) + rng.normal(0, jitter, 3)
            slope = np.array([ahead * tilt, 0.02, 0.0]) * altitude
            views.append((eye, eye + slope - np.array([0, 0, altitude])))
    return views
