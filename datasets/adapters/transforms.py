"""Scenes described by JSON frames: nerfstudio's transforms.json and NeRF's Blender scenes.

Both give camera-to-world matrices with OpenGL camera axes (right, up, back).
"""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.files import read_json
from splatproof.base.inside import inside
from splatproof.base.numbers import finite, image_size
from splatproof.datasets.adapters.ply_points import read_ply_points
from splatproof.datasets.adapters.posed import (
    OPENGL_TO_OPENCV,
    checked_pose,
    field_of_view,
    pinhole_camera,
    positive,
)
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.colmap_library import pycolmap
from splatproof.datasets.layout import FULL_SIZE_FOLDERS, MISSING, Layout, PosedPhoto, copy_factor
from splatproof.datasets.photos import PHOTO_SUFFIXES, list_photos, photo_size
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""Nerfstudio reads all of these with the same parameters: k1, k2, k3 radial, p1, p2 tangential."""
FISHEYE = "OPENCV_FISHEYE"
BLENDER_FILES = ("transforms_train.json", "transforms_test.json")
VALIDATION = "validation view: the paper trains on the training and tests on the test views"


def read_frames(
    path: Path, key: str = "file_path", kind: type = str
) -> tuple[dict[str, object], list[dict[str, object]]]:
    """(everything else, frames) of a transforms file.

    Args:
        path: The file.
        key: Field that names a frame's image.
        kind: Type of that field.
    Raises: DataError naming the fault.
    """
    data = read_json(path)
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise DataError(f"{path}: has no list 'frames'; expected a transforms file")
    for i, frame in enumerate(frames):
        if not isinstance(frame.get(key), kind):
            raise DataError(
                f"{path}: frame {i} has {key} {frame.get(key)!r}, expected a value of type "
                f"{kind.__name__}"
            )
    return data, frames


def opengl_pose(frame: dict[str, object], where: str) -> Float64[np.ndarray, "3 4"]:
    """Camera to world of a frame, its camera axes turned to OpenCV's.

    Args:
        frame: One entry of the list `frames` of a transforms file.
        where: File and frame, for errors.
    Raises: DataError where its `transform_matrix` is no rigid motion.
    """
    pose = checked_pose(frame.get("transform_matrix"), where)
    pose[:, :3] = pose[:, :3] @ OPENGL_TO_OPENCV
    return pose


def open_nerfstudio(folder: Path, protocol: Protocol) -> Scene:
    """Read a nerfstudio scene: intrinsics for all frames or for each, a split if it has one.

    A frame's own number wins over the file's. Without `camera_model` lenses are fisheyes where
    `is_fisheye`, of instant-ngp's captures, says so. These may give the field of view in place of
    focal lengths, and leave out size and principal point, which are the photo's own and its middle then.
    `test_filenames` is the test split (without it `val_filenames`); images that no list names are left out.
    `protocol.images` other than "photos" or "images" names the folder of smaller copies beside the frames' own.
    `ply_file_path` gives the sparse points, in the frame of the frames' own matrices. Frames whose
    photo is not there, as in the captures of instant-ngp, are left out with that reason, unless the
    protocol is strict. Pixels
    where the image of `mask_path` is black are not used; copies have theirs in masks_N.

    Args:
        folder: The scene's folder, with transforms.json.
        protocol: Copies of the photos to read, image sizes, undistortion, and the split where the
            file has none.
    Raises: DataError for cameras that are no pinhole even undistorted, or for files.

    Source: nerfstudio 1.1, nerfstudio_dataparser.py; instant-ngp, scripts/colmap2nerf.py.
    """
    path = folder / "transforms.json"
    data, frames = read_frames(path)
    lists = _lists(path, data, {str(Path(str(frame["file_path"]))) for frame in frames})
    photos, left_out, unused = [], [], []
    for frame in frames:
        name = Path(str(frame["file_path"])).as_posix()
        where = f"{path}: frame {name}"
        split = None if lists is None else lists.get(name)
        file = inside(folder, name, where)
        if protocol.images not in FULL_SIZE_FOLDERS:
            file = file.parent.with_name(protocol.images) / file.name
        if lists is not None and split is None:
            left_out.append((name, "in neither the training nor the test list of transforms.json"))
            unused.append(file)
            continue
        if not protocol.strict and not file.is_file():
            left_out.append((name, f"{MISSING}: {file}"))
            unused.append(file)
            continue
        photos.append(
            PosedPhoto(
                name=name,
                path=file,
                camera=_camera(
                    _completed({**data, **frame}, inside(folder, name, where), where), where
                ),
                camera_to_world=opengl_pose(frame, where),
                split="test" if split == "test" else "train" if split else None,
                factor=copy_factor(protocol.images),
                valid=_mask(folder, frame, copy_factor(protocol.images), where),
            )
        )
    if not frames:
        raise DataError(f"{path}: has no frames, expected one a photo")
    if not photos:
        raise DataError(
            f"{path}: not one photo of its {len(frames)} frames is there, expected {unused[0]} and "
            "others; put them where the frames say"
        )
    left_out += _unlisted(folder, [*(photo.path for photo in photos), *unused])
    layout = Layout(
        adapter="nerfstudio", photos=photos, description=[path], left_out=tuple(left_out)
    )
    cloud = data.get("ply_file_path")
    if cloud is not None:
        if not isinstance(cloud, str):
            raise DataError(f"{path}: ply_file_path is {cloud!r}, expected a file name")
        file = inside(folder, cloud, f"{path}: ply_file_path")
        layout = replace(layout, points=read_ply_points(file), description=[path, file])
    return open_layout(folder, layout, protocol)


def _unlisted(folder: Path, known: Sequence[Path]) -> list[tuple[str, str]]:
    """Photos beside those that frames name, which no frame names."""
    names = {path.resolve() for path in known}
    beside = sorted(
        path
        for place in sorted({path.parent for path in known})
        if place.is_dir()
        for path in place.iterdir()
        if path.suffix.lower() in PHOTO_SUFFIXES and path.resolve() not in names
    )
    return [
        (
            os.path.relpath(path, folder).replace(os.sep, "/"),
            "no frame of a transforms file names it",
        )
        for path in beside
    ]


def _mask(folder: Path, frame: dict[str, object], factor: int, where: str) -> Path | None:
    """Mask image of a frame, where it names one. Raises: DataError if it is not there."""
    name = frame.get("mask_path")
    if name is None:
        return None
    file = inside(folder, str(name), f"{where}: mask_path")
    if factor > 1:
        file = folder / f"masks_{factor}" / file.name
    if not file.is_file():
        raise DataError(f"{file}: mask is missing, but {where} names it")
    return file


def _lists(path: Path, data: dict[str, object], known: set[str]) -> dict[str, str] | None:
    """Split of each listed image, or None where the file has no lists."""
    held = "test_filenames" if "test_filenames" in data else "val_filenames"
    if "train_filenames" not in data and held not in data:
        return None
    splits: dict[str, str] = {}
    for key, split in (("train_filenames", "train"), (held, "test")):
        names = data.get(key)
        if not isinstance(names, list):
            raise DataError(f"{path}: {key} is {names!r}, expected a list of file names")
        for name in (Path(str(name)).as_posix() for name in names):
            if name not in known:
                raise DataError(f"{path}: {key} has {name!r}, which no frame has")
            if name in splits:
                raise DataError(f"{path}: {name!r} is listed twice, in {splits[name]} and {split}")
            splits[name] = split
    return splits


def _completed(values: dict[str, object], photo: Path, where: str) -> dict[str, object]:
    """Intrinsics with what captures of instant-ngp may leave out: size, focal lengths, principal point."""
    known = dict(values)
    if not {"w", "h"} & known.keys() and photo.is_file():
        known["w"], known["h"] = photo_size(photo)
    width, height = image_size(known.get("w"), known.get("h"), where)
    angles = (("fl_x", "camera_angle_x", width), ("fl_y", "camera_angle_y", height))
    for focal, angle, side in angles:
        if focal not in known and angle in known:
            known[focal] = side / (2 * math.tan(field_of_view(known[angle], where, angle) / 2))
    known.setdefault("fl_y", known.get("fl_x"))  # square pixels
    return {"cx": width / 2, "cy": height / 2} | known


def _camera(values: dict[str, object], where: str) -> pycolmap.Camera:
    model = values.get("camera_model", FISHEYE if values.get("is_fisheye") else "OPENCV")
    if model not in (*PERSPECTIVE, FISHEYE):
        raise DataError(
            f"{where}: camera_model is {model!r}, expected one of {', '.join(PERSPECTIVE)} or "
            f"{FISHEYE}; cut other photos into perspective views first"
        )
    width, height = image_size(values.get("w"), values.get("h"), where)
    fx, fy, cx, cy = (positive(values.get(k), where, k) for k in ("fl_x", "fl_y", "cx", "cy"))
    bend = {key: _number(values.get(key, 0.0), where, key) for key in _DISTORTION}
    k1, k2, k3, k4, p1, p2 = bend.values()
    if model == FISHEYE:
        if p1 or p2:
            raise DataError(f"{where}: a fisheye camera has p1 {p1}, p2 {p2}; expected 0")
        kind, params = "OPENCV_FISHEYE", [fx, fy, cx, cy, k1, k2, k3, k4]
    elif k4:
        raise DataError(f"{where}: k4 is {k4}, which only {FISHEYE} has; expected 0")
    elif not any(bend.values()):
        return pinhole_camera(width, height, fx, fy, cx, cy, where=where)
    else:
        kind, params = "FULL_OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    return pycolmap.Camera(model=kind, width=width, height=height, params=params)


_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def _number(value: object, where: str, name: str) -> float:
    number = finite(value)
    if number is None:
        raise DataError(f"{where}: {name} is {value!r:.60}, expected a finite number")
    return number


def open_blender(folder: Path, protocol: Protocol) -> Scene:
    """Read a Blender scene of NeRF: f = w / (2 tan(camera_angle_x / 2)), principal point central.

    Transparent pixels are laid on the protocol's background. Validation views are left out.
    The frame is Blender's: z is up. The set has no sparse points.

    Args:
        folder: The scene's folder, with the two transforms files and the photos that they name.
        protocol: Image sizes, and the background behind transparent pixels; the split is the
            files', unless it names the test views.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Mildenhall et al. 2020, data release.
    """
    photos = []
    for described, split in zip(BLENDER_FILES, ("train", "test"), strict=True):
        path = folder / described
        data, frames = read_frames(path)
        angle = field_of_view(data.get("camera_angle_x"), str(path), "camera_angle_x")
        for frame in frames:
            name = Path(f"{frame['file_path']}.png").as_posix()
            file = inside(folder, name, f"{path}: file_path")
            width, height = photo_size(file)
            focal = width / (2 * math.tan(angle / 2))
            photos.append(
                PosedPhoto(
                    name=name,
                    path=file,
                    camera=pinhole_camera(
                        width, height, focal, focal, width / 2, height / 2, where=str(path)
                    ),
                    camera_to_world=opengl_pose(frame, f"{path}: frame {name}"),
                    split="train" if split == "train" else "test",
                )
            )
    layout = Layout(
        adapter="blender",
        photos=photos,
        description=[folder / file for file in BLENDER_FILES],
        up=(0.0, 0.0, 1.0),
        flatten=True,
        left_out=(
            *_unlisted(folder, [photo.path for photo in photos]),
            *(
                (f"val/{name}", VALIDATION)
                for name in (list_photos(folder / "val") if (folder / "val").is_dir() else [])
            ),
        ),
    )
    return open_layout(folder, layout, protocol)
