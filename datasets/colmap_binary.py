"""Walks COLMAP's binary model files to their last byte (layout: COLMAP, "Output Format")."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes
from splatproof.datasets.colmap_index import ModelIndex, parameter_count

SUFFIX = ".bin"


class _Walk:
    """A position in a file that refuses to pass its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = read_bytes(path)
        self.at = 0
        self.what = "its header"

    def skip(self, size: int) -> int:
        """Move on by a number of bytes; returns where they start."""
        start = self.at
        if size < 0 or start + size > len(self.data):
            raise DataError(
                f"{self.path}: ends at byte {len(self.data)} inside {self.what}, which needs "
                f"{start + size}; the file is cut short or damaged, copy it again"
            )
        self.at += size
        return start

    def read(self, layout: struct.Struct) -> tuple[int, ...]:
        """Unpack the next record."""
        return layout.unpack_from(self.data, self.skip(layout.size))

    def text(self) -> str:
        """Read the next zero-terminated name."""
        end = self.data.find(b"\0", self.at)
        start = self.skip((end if end >= 0 else len(self.data)) + 1 - self.at)
        try:
            return self.data[start : self.at - 1].decode()
        except UnicodeDecodeError:
            raise DataError(f"{self.path}: {self.what} has a name that is not UTF-8") from None


_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I56xI")
_POINT = np.dtype(
    [
        ("id", "<u8"), ("position", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("length", "<u8"),
    ]
)  # fmt: skip
"""What stands before the track of a point."""
_LENGTH = struct.Struct(f"<{_POINT.itemsize - 8}xQ")
_RIG = struct.Struct("<II")
_SENSOR = struct.Struct("<iI")
_FLAG = struct.Struct("<B")
_FRAME = struct.Struct("<II56xI")
_POSE_BYTES = 7 * 8


def _records(walk: _Walk, kind: str, one: Callable[[_Walk], object]) -> list:
    """Walk all records of a file, which must end exactly behind the last one."""
    (count,) = walk.read(_COUNT)
    found = []
    for i in range(count):
        walk.what = f"{kind} {i + 1} of {count}"
        found.append(one(walk))
    if walk.at != len(walk.data):
        raise DataError(
            f"{walk.path}: {len(walk.data) - walk.at} bytes are left behind the {count} {kind}s that "
            "its header announces; the file is damaged"
        )
    return found


def _camera(walk: _Walk) -> int:
    number, model, _, _ = walk.read(_CAMERA)
    walk.skip(8 * parameter_count(walk.path, model))
    return number


def _image(walk: _Walk) -> tuple[int, str, int, int]:
    number, camera = walk.read(_IMAGE)
    name = walk.text()
    (observations,) = walk.read(_COUNT)
    walk.skip(24 * observations)
    return number, name, camera, observations


def _point(walk: _Walk) -> int:
    """Where the record starts: a number alone, of which there are as many as points."""
    start = walk.at
    (length,) = walk.read(_LENGTH)
    walk.skip(8 * length)
    return start


def _points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The points as rows of _POINT, and (image, 2D point) of all tracks after each other."""
    walk = _Walk(path)
    starts = np.array(_records(walk, "point", _point), dtype=np.int64)
    if not len(starts):
        return np.empty(0, dtype=_POINT), np.empty((0, 2), dtype="<u4")
    raw = np.frombuffer(walk.data, dtype=np.uint8)
    points = sliding_window_view(raw, _POINT.itemsize)[starts].view(_POINT)[:, 0]
    begins = starts + _POINT.itemsize
    ends = begins + 8 * points["length"].astype(np.int64)
    pieces = zip(begins.tolist(), ends.tolist(), strict=True)
    tracks = b"".join([walk.data[begin:end] for begin, end in pieces])
    return points, np.frombuffer(tracks, dtype="<u4").reshape(-1, 2)


def _rig(walk: _Walk) -> None:
    _, sensors = walk.read(_RIG)
    for i in range(sensors):
        walk.read(_SENSOR)
        if i > 0 and walk.read(_FLAG)[0]:  # the first one is the reference and has no pose
            walk.skip(_POSE_BYTES)


def _frame(walk: _Walk) -> None:
    _, _, sensors = walk.read(_FRAME)
    walk.skip((_SENSOR.size + _COUNT.size) * sensors)


def image_names(folder: Path) -> list[str]:
    """Names of the images of a model. Raises: DataError as `index_binary`."""
    return [name for _, name, _, _ in _records(_Walk(folder / "images.bin"), "image", _image)]


def index_binary(folder: Path) -> ModelIndex:
    """Walk cameras.bin, images.bin, points3D.bin and, where they are, rigs.bin and frames.bin.

    Raises: DataError if a file ends early or late, or has an unknown camera model.
    """
    cameras = _records(_Walk(folder / "cameras.bin"), "camera", _camera)
    images = _records(_Walk(folder / "images.bin"), "image", _image)
    points, tracks = _points(folder / "points3D.bin")
    for name, one in (("rig", _rig), ("frame", _frame)):
        if (folder / f"{name}s.bin").exists():
            _records(_Walk(folder / f"{name}s.bin"), name, one)
    return ModelIndex(
        cameras=cameras,
        image_ids=[image[0] for image in images],
        image_names=[image[1] for image in images],
        image_cameras=[image[2] for image in images],
        image_observations=[image[3] for image in images],
        point_ids=points["id"].astype(np.uint64),
        positions=points["position"].astype(np.float64),
        colours=points["colour"].copy(),
        track_lengths=points["length"].astype(np.int64),
        track_images=tracks[:, 0].astype(np.int64),
        track_observations=tracks[:, 1].astype(np.int64),
    )
