"""What a COLMAP model's files refer to: enough to check a model before COLMAP's reader sees it.

COLMAP's own reader does not notice the end of a file: a truncated model is filled with whatever
was in memory, or read for ever. So every file is walked first.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64, UInt8

from splatproof.base.errors import DataError
from splatproof.datasets.colmap_library import pycolmap

Value = TypeVar("Value", int, str)
MODEL_FILES = ("cameras", "images", "points3D")
RIG_FILES = ("rigs", "frames")


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelIndex:
    """Ids and references of a model, in file order."""

    cameras: list[int]
    image_ids: list[int]
    image_names: list[str]
    image_cameras: list[int]
    image_observations: list[int]
    """Number of 2D points of each image."""
    point_ids: np.ndarray
    positions: Float64[np.ndarray, "points 3"]
    """World positions of the points in scene units."""
    colours: UInt8[np.ndarray, "points 3"]
    track_lengths: np.ndarray
    track_images: np.ndarray
    """Image id of every track element, all points after each other."""
    track_observations: np.ndarray
    """Index into that image's 2D points."""


def parameter_count(path: Path, model: int | str) -> int:
    """Number of parameters of a camera model.

    Args:
        path: File that has the camera, for errors.
        model: COLMAP's id of the camera model, or its name.
    Raises: DataError for a model that COLMAP does not know.
    """
    try:
        kind = pycolmap.CameraModelId(model) if isinstance(model, int) else model
        name = kind if isinstance(kind, str) else kind.name
        return len(pycolmap.Camera.create_from_model_name(1, name, 1.0, 1, 1).params)
    except (ValueError, IndexError):
        known = ", ".join(n for n in pycolmap.CameraModelId.__members__ if n != "INVALID")
        raise DataError(f"{path}: unknown camera model {model!r}; known are {known}") from None


def check_references(folder: Path, suffix: str, index: ModelIndex) -> None:
    """Raise DataError on the first id that is double or that nothing answers to.

    Args:
        folder: The model's folder, for errors.
        suffix: ".bin" or ".txt", for errors.
        index: Ids and references as read from the files.
    """
    for what, ids in (
        ("cameras", index.cameras),
        ("images", index.image_ids),
        ("points3D", index.point_ids.tolist()),
    ):
        if (double := _double(ids)) is not None:
            raise DataError(f"{folder / (what + suffix)}: id {double} occurs more than once")
    images = folder / f"images{suffix}"
    if (double := _double(index.image_names)) is not None:
        raise DataError(f"{images}: image name {double!r} occurs more than once")
    known = set(index.cameras)
    for name, camera in zip(index.image_names, index.image_cameras, strict=True):
        if camera not in known:
            raise DataError(
                f"{images}: image {name!r} has camera {camera}, which cameras{suffix} lacks; "
                f"there are {sorted(known)[:8]}"
            )
    _check_tracks(folder / f"points3D{suffix}", suffix, index)


def _double(values: Iterable[Value]) -> Value | None:
    """The first value that was there before; None where all differ."""
    seen = set[Value]()
    for value in values:
        if value in seen:
            return value
        seen.add(value)
    return None


def _check_tracks(path: Path, suffix: str, index: ModelIndex) -> None:
    """Every track element must name an image and one of its 2D points."""
    order = np.argsort(index.image_ids)
    ids = np.asarray(index.image_ids, dtype=np.int64)[order]
    counts = np.asarray(index.image_observations, dtype=np.int64)[order]
    points = np.repeat(index.point_ids, index.track_lengths)
    if not len(points):
        return
    place = np.searchsorted(ids, index.track_images).clip(max=max(len(ids) - 1, 0))
    wrong = ids[place] != index.track_images if len(ids) else np.ones(len(points), dtype=bool)
    if wrong.any():
        i = int(wrong.argmax())
        raise DataError(
            f"{path}: the track of point {points[i]} has image {index.track_images[i]}, "
            f"which images{suffix} lacks"
        )
    wrong = index.track_observations >= counts[place]
    if wrong.any():
        i = int(wrong.argmax())
        raise DataError(
            f"{path}: the track of point {points[i]} has 2D point {index.track_observations[i]} "
            f"of image {index.track_images[i]}, which has only {counts[place][i]}"
        )
