"""Cameras to render from, as a JSON file: where they stand, and when and in whose light they look."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import read_json
from splatproof.base.inside import checked_name
from splatproof.base.memory import check_room
from splatproof.base.names import did_you_mean
from splatproof.base.numbers import finite, image_size
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import View, camera_view

KEYS = ("name", "width", "height", "K", "world_to_camera")
"""What every entry has."""
PEAK = 32
"""Bytes a pixel of a rendered view, at the least: colour, depth and opacity, and a copy to write."""
MORE = ("time", "sensor", "appearance")
"""What an entry may have besides."""


def read_cameras(path: str | Path) -> dict[str, View]:
    """Views that nobody took, by name, from a JSON list of objects with the keys of KEYS.

    They may also have those of MORE, which models that know of them obey: `time` in seconds since
    the scene's first view, `sensor` the name of a physical camera, `appearance` the name of the
    training view in whose light and exposure the model is shown.

    Args:
        path: K is 3 x 3 in pixels, world_to_camera 4 x 4 rigid and row-major with OpenCV axes.

    Raises: DataError, in one line, naming the file, the entry and the fault.
    """
    path = Path(path)
    entries = read_json(path)
    if not isinstance(entries, list) or not entries:
        raise DataError(f"{path}: expected a list of at least one camera")
    views: dict[str, View] = {}
    for index, entry in enumerate(entries):
        where = f"{path}: camera {index}"
        known = (*KEYS, *MORE)
        strange = [key for key in entry if key not in known] if isinstance(entry, dict) else []
        if strange:
            raise DataError(f"{where}: unknown {strange[0]!r}{did_you_mean(strange[0], known)}")
        if not isinstance(entry, dict) or not set(KEYS) <= set(entry):
            raise DataError(f"{where}: expected an object with {', '.join(KEYS)}")
        name = entry["name"]
        if not isinstance(name, str) or not name or name in views:
            raise DataError(f"{where}: name {name!r}, expected a text that no other camera has")
        checked_name(name, where)
        view = camera_view(_camera(entry, where), name, time=_time(entry, where))
        views[name] = replace(view, **_words(entry, where))
    return views


def _time(entry: dict[str, Any], where: str) -> float | None:
    """Seconds since the scene's first view; None where the entry does not say."""
    if "time" not in entry:
        return None
    time = entry["time"]
    seconds = finite(time)
    if seconds is None:
        raise DataError(f"{where}: time {time!r:.60}, expected a finite number of seconds")
    return seconds


def _words(entry: dict[str, Any], where: str) -> dict[str, Any]:
    """Sensor and appearance, where the entry says them."""
    said = {key: entry[key] for key in ("sensor", "appearance") if key in entry}
    for key, value in said.items():
        if not isinstance(value, str) or not value:
            raise DataError(f"{where}: {key} {value!r}, expected a name")
    return said


def _camera(entry: dict[str, Any], where: str) -> Camera:
    """One camera, checked."""
    for side in ("width", "height"):
        if not isinstance(entry[side], int) or entry[side] < 1:
            raise DataError(f"{where}: {side} {entry[side]!r:.60}, expected a whole number >= 1")
    width, height = image_size(entry["width"], entry["height"], where)
    check_room(f"{where}: an image of {width} x {height}", width * height * PEAK)
    K, pose = _matrix(entry, "K", 3, where), _matrix(entry, "world_to_camera", 4, where)
    if min(K[0, 0], K[1, 1]) <= 0 or K[1, 0] or K[0, 1] or K[2].tolist() != [0, 0, 1]:
        raise DataError(
            f"{where}: K is {K.tolist()}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    turn = pose[:3, :3]
    off = float((turn @ turn.T - torch.eye(3).double()).abs().max())
    # 1e-4 lets matrices through that were printed with five digits
    if off > 1e-4 or torch.linalg.det(turn) < 0 or pose[3].tolist() != [0, 0, 0, 1]:
        raise DataError(f"{where}: world_to_camera is not rigid (off by {off:.2g})")
    return Camera(K=K, world_to_camera=pose, width=width, height=height)


def _matrix(entry: dict[str, Any], key: str, size: int, where: str) -> Float[Tensor, "n n"]:
    """A square matrix of finite numbers in float64."""
    try:
        matrix = torch.tensor(entry[key], dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        matrix = torch.full((1,), math.nan)
    if matrix.shape != (size, size) or not matrix.isfinite().all():
        raise DataError(f"{where}: {key} is not a {size} x {size} list of finite numbers")
    return matrix
