"""MatrixCity: JSON frames of city blocks, as rendered (rot_mat) or as split by the release (pose/).

Camera axes are OpenGL's (right, up, back). The world is z-up; we keep its axes, in metres.
"""

import math
import os
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.inside import inside
from splatproof.datasets.adapters.posed import (
    OPENGL_TO_OPENCV,
    checked_pose,
    field_of_view,
    pinhole_camera,
    positive,
)
from splatproof.datasets.adapters.transforms import read_frames
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.photos import list_photos, photo_size
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

RAW_ROTATION = 100.0
"""The rendered poses hold a rotation divided by this."""
SPLIT_UNIT = 100.0
"""Metres of a unit in pose/: the release divides positions by 100."""
SPLITS: dict[str, Literal["train", "test"]] = {"train": "train", "test": "test"}
WHOLE = "pose/block_all"


def recognises(folder: Path) -> bool:
    """Whether a folder is a city's aerial or street part, or one of its splits in pose/."""
    split = folder.parent.name == "pose" and (folder / "transforms_train.json").is_file()
    return split or (folder / WHOLE).is_dir() or bool(_blocks(folder, "train"))


def open_matrix_city(folder: Path, protocol: Protocol) -> Scene:
    """Read pose/<block> (a split of the release) or a whole part (small_city/aerial, ...).

    A whole part is its pose/block_all where there is one, else all blocks in train and test.
    Test views are those of the folder test. No sparse points.

    Args:
        folder: A split's folder pose/<block>, or the folder of a whole part.
        protocol: Image sizes; the split is the set's, unless it names the test views.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Li et al. 2023 (MatrixCity), release: README and scripts/load_aerial.py, load_street.py.
    """
    if (folder / WHOLE).is_dir():
        return open_matrix_city(folder / WHOLE, protocol)
    split = (folder / "transforms_train.json").is_file()
    city = folder.parent.parent if split else folder
    photos, files = [], []
    for name, side in SPLITS.items():
        listed = [folder / f"transforms_{name}.json"] if split else _blocks(folder, name)
        for path in listed:
            photos += _split_block(city, path, side) if split else _raw_block(city, path, side)
        files += listed
    known = {photo.name for photo in photos}
    blocks = sorted({photo.path.parent for photo in photos})
    left_out = [
        (name, f"no frame in {'pose/' + folder.name if split else 'transforms.json'}")
        for block in blocks
        for name in (_name(block / photo, city) for photo in list_photos(block))
        if name not in known
    ]
    layout = Layout(
        adapter="matrixcity",
        photos=photos,
        description=files,
        up=(0.0, 0.0, 1.0),
        units="metres",
        left_out=tuple(left_out),
    )
    return open_layout(folder, layout, protocol)


def _blocks(folder: Path, split: str) -> list[Path]:
    """The files transforms.json of the rendered blocks of a split, by name."""
    return sorted((folder / split).glob("*/transforms.json"))


def _split_block(city: Path, path: Path, side: Literal["train", "test"]) -> list[PosedPhoto]:
    data, frames = read_frames(path)
    width, height, fx, fy, cx, cy = (
        positive(data.get(key), str(path), key) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")
    )
    camera = pinhole_camera(width, height, fx, fy, cx, cy, where=str(path))
    photos = []
    for frame in frames:
        where = f"{path}: frame {frame['file_path']}"
        pose = _opengl(checked_pose(frame.get("transform_matrix"), where), SPLIT_UNIT)
        file = inside(path.parent, str(frame["file_path"]), f"{where}: file_path", within=city)
        file = Path(os.path.normpath(file))
        photos.append(
            PosedPhoto(
                name=_name(file, city),
                path=file,
                camera=camera,
                camera_to_world=pose,
                split=side,
            )
        )
    return photos


def _name(file: Path, city: Path) -> str:
    return Path(os.path.relpath(file, city)).as_posix()


def _raw_block(city: Path, path: Path, side: Literal["train", "test"]) -> list[PosedPhoto]:
    data, frames = read_frames(path, key="frame_index", kind=int)
    angle = field_of_view(data.get("camera_angle_x"), str(path), "camera_angle_x")
    photos = []
    for frame in frames:
        where = f"{path}: frame {frame['frame_index']}"
        matrix = np.array(frame.get("rot_mat"), dtype=object)
        if matrix.shape != (4, 4):
            raise DataError(f"{where}: rot_mat is {frame.get('rot_mat')!r:.80}, expected 4 x 4")
        matrix = np.concatenate([matrix[:3, :3] * RAW_ROTATION, matrix[:3, 3:]], axis=1)
        file = path.parent / f"{frame['frame_index']:04d}.png"
        width, height = photo_size(file)
        focal = width / (2 * math.tan(angle / 2))
        photos.append(
            PosedPhoto(
                name=file.relative_to(city).as_posix(),
                path=file,
                camera=pinhole_camera(width, height, focal, focal, width / 2, height / 2),
                camera_to_world=_opengl(checked_pose(matrix, where), 1.0),
                split=side,
            )
        )
    return photos


def _opengl(pose: Float64[np.ndarray, "3 4"], unit: float) -> Float64[np.ndarray, "3 4"]:
    """The pose with OpenCV camera axes, its position in metres."""
    return np.concatenate([pose[:, :3] @ OPENGL_TO_OPENCV, pose[:, 3:] * unit], axis=1)
