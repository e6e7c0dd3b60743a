"""A scene as a data set's files describe it, before a protocol's rules: what every adapter reads."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64

from splatproof.base.errors import DataError
from splatproof.datasets.colmap_library import has_focal_length, pycolmap
from splatproof.reference.types.scene import SparsePoints

FULL_SIZE_FOLDERS = ("photos", "images")
"""Two names of the folder that has the photos as calibrated."""
MISSING = "its photo is missing"
"""Why a view is left out whose photo is not there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedPhoto:
    """A photo as a data set describes it, its pose in our axes already."""

    name: str
    """Unique in the scene; views are sorted by it."""
    path: Path
    camera: pycolmap.Camera
    """Size, intrinsics and distortion as calibrated."""
    camera_to_world: Float64[np.ndarray, "3 4"]
    """OpenCV camera axes (right, down, forward) to the scene's frame."""
    split: Literal["train", "test"] | None = None
    """What the set ships; None where it ships no split."""
    factor: int = 1
    """The file may be a copy this many times smaller than calibrated (see `copy_factor`)."""
    valid: Path | None = None
    """Mask image of the photo's size: 0 where a pixel must not be used."""
    sky: Path | None = None
    """Mask image of the photo's size: above 0 where there is sky."""
    moving: Mapping[str, Path | Callable[[], Bool[np.ndarray, "h w"]]] = field(default_factory=dict)
    """What moves: kind ("vehicles", "people") to a mask image of the photo's size, above 0 where such
    a thing is, or to what makes such a mask. Empty: not known."""
    time: float | None = None
    """Seconds from any start."""
    sensor: str = ""


class Hits(NamedTuple):
    """What a LiDAR's file has, in the set's own frame."""

    positions: Float64[np.ndarray, "n 3"]
    """Where rays hit."""
    origin: Float64[np.ndarray, "3"]
    """Where the sensor was."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepFile:
    """One turn of a LiDAR."""

    time: float
    """Seconds from the same start as the photos' times."""
    path: Path
    read: Callable[[], Hits]
    """Reads the file. It can be pickled: views are sent to other processes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """A data set's scene as read from its files."""

    adapter: str
    photos: Sequence[PosedPhoto]
    description: Sequence[Path] = ()
    """Files that say where the cameras are; their bytes are hashed for the record."""
    points: SparsePoints | None = None
    """None: the set has no sparse points; a bounded sample of the sweeps' points stands for them."""
    sweeps: Sequence[SweepFile] = ()
    """In order of time."""
    up: tuple[float, float, float] | None = None
    """Unit vector against gravity where the format fixes it; None: guessed from the cameras."""
    up_source: str = "data set"
    units: str = "sfm"
    left_out: tuple[tuple[str, str], ...] = ()
    flatten: bool = False
    """Transparent photos are laid on the protocol's background instead of refused."""
    facts: dict[str, str] = field(default_factory=dict)
    """Further facts for the record."""


def check_layout(layout: Layout, where: Path) -> None:
    """Refuse numbers that nothing can be made of, whichever adapter read them.

    Args:
        layout: What the adapter read.
        where: File that says where the cameras are, or the scene's folder; for errors.
    Raises: DataError naming the photo or the point.
    """
    for photo in layout.photos:
        if not has_focal_length(photo.camera):
            raise DataError(
                f"{where}: the camera of {photo.name!r} has parameters "
                f"{photo.camera.params.tolist()}, expected finite ones and positive focal lengths"
            )
        if not np.isfinite(photo.camera_to_world).all():
            raise DataError(
                f"{where}: the pose of {photo.name!r} is {photo.camera_to_world.tolist()}, expected "
                "finite numbers"
            )
    if layout.points is None:
        return
    if layout.points.colours.dtype != torch.uint8:
        raise DataError(
            f"{where}: the points' colours are {layout.points.colours.dtype}, expected torch.uint8 "
            "from 0 to 255"
        )
    finite = layout.points.positions.isfinite().all(dim=1)
    if not bool(finite.all()):
        number = int((~finite).nonzero()[0, 0])
        raise DataError(f"{where}: point {number} (from 0) is not finite")


def plain_points(positions: Float64[np.ndarray, "n 3"], colours: np.ndarray) -> SparsePoints:
    """Points without tracks.

    Args:
        positions: Places in the scene's frame.
        colours: RGB of each, uint8, n x 3.
    """
    return SparsePoints(
        positions=torch.from_numpy(positions),
        colours=torch.from_numpy(colours),
        track_starts=torch.zeros(len(positions) + 1, dtype=torch.int64),
        track_views=torch.zeros(0, dtype=torch.int64),
    )


def copy_factor(folder: str) -> int:
    """How many times smaller than calibrated a folder's photos are: N for NAME_<N>, else 1."""
    named = re.search(r"_(\d+)$", folder)
    return max(int(named.group(1)), 1) if named else 1
