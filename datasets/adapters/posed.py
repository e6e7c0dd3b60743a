"""What the adapters share: checked numbers and poses, turned to OpenCV axes."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.numbers import Number, image_size, in_range
from splatproof.datasets.colmap_library import pycolmap

RIGID = 1e-3
"""How far R R^T may be from the identity: files hold float32 or few digits."""
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])
"""Camera axes right, up, back to right, down, forward."""


def pinhole_camera(
    width: Number,
    height: Number,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    *,
    where: str = "camera",
) -> pycolmap.Camera:
    """An undistorted camera; everything in pixels, pixel centres at .5.

    Args:
        width: Width of the photo.
        height: Height of the photo.
        fx: Focal length along x.
        fy: Focal length along y.
        cx: Principal point from the photo's left edge.
        cy: Principal point from the photo's upper edge.
        where: File and place that give them, for errors.
    Raises: DataError for a size that no photo has.
    """
    width, height = image_size(width, height, where)
    return pycolmap.Camera(model="PINHOLE", width=width, height=height, params=[fx, fy, cx, cy])


def checked_pose(matrix: object, where: str) -> Float64[np.ndarray, "3 4"]:
    """The upper 3 x 4 of a camera-to-world matrix, its rotation made exactly orthonormal.

    Args:
        matrix: 3 x 4 or 4 x 4 numbers.
        where: File and frame, for errors.
    Raises: DataError if it is no rigid motion.
    """
    try:
        values = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0)
    if values.shape not in ((3, 4), (4, 4)) or not np.isfinite(values).all():
        raise DataError(f"{where}: the pose is not a 3 x 4 or 4 x 4 matrix of finite numbers")
    rotation = values[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > RIGID or np.linalg.det(rotation) < 0:
        raise DataError(
            f"{where}: the pose is no rotation (R R^T is {off:.3g} off the identity, determinant "
            f"{np.linalg.det(rotation):.3g}); expected an orthonormal matrix of determinant 1"
        )
    left, _, right = np.linalg.svd(rotation)
    return np.concatenate([left @ right, values[:3, 3:]], axis=1)


def positive(value: Any, where: str, name: str) -> float:
    """A value from a file as a finite number above 0.

    Args:
        value: What the file has, of any type.
        where: File and frame, for errors.
        name: Name of the field, for errors.
    Raises: DataError naming the file and the field.
    """
    in_range(value, f"{where}: {name}", above=True, fault=DataError)
    return float(value)


def field_of_view(value: Any, where: str, name: str) -> float:
    """A value from a file as an angle above 0 and below pi, in radians.

    Args:
        value: As for `positive`.
        where: File and frame, for errors.
        name: Name of the field, for errors.
    Raises: DataError naming the file and the field.
    """
    angle = positive(value, where, name)
    if angle >= math.pi:
        raise DataError(f"{where}: {name} is {angle}, expected radians below pi")
    return angle


def find_photo(stem: Path, suffixes: Sequence[str], listed_in: Callable[[], str]) -> Path:
    """The photo that a file names without its suffix.

    Args:
        stem: Path of the photo without a suffix.
        suffixes: Suffixes to try in this order, each with its dot.
        listed_in: Gives the name of the file that lists the photo; called for the error alone.
    Raises: DataError naming the stem where there is no such file.
    """
    for suffix in suffixes:
        path = stem.with_name(stem.name + suffix)
        if path.is_file():
            return path
    raise DataError(
        f"{stem}: photo is missing with any of {', '.join(suffixes)}, but {listed_in()} lists it"
    )
