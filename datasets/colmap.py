"""Opens COLMAP scene folders: a model in sparse/0 or sparse, photos beside it."""

import copy
import hashlib
import re
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pycolmap
import torch

from splatbench.datasets.colmap_model import Model, find_model, pose_matrix, read_model
from splatbench.datasets.depth_maps import depth_loader
from splatbench.datasets.frame import origin_shift, up_vector
from splatbench.datasets.images import TensorCache
from splatbench.datasets.photos import list_photos, photo_size
from splatbench.datasets.resize import scale_intrinsics, scaled_size
from splatbench.datasets.scene_file import SceneFile, read_scene_file
from splatbench.datasets.sparse_points import read_points, seen_in_training
from splatbench.datasets.splits import split_hash, split_views
from splatbench.datasets.truth import Truth
from splatbench.datasets.undistort import Undistortion, is_pinhole, plan_undistortion
from splatbench.reference.camera import Camera
from splatbench.reference.errors import DataError, UsageError
from splatbench.reference.protocol import Protocol
from splatbench.reference.scene import Scene, View

FULL_SIZE_FOLDERS = ("photos", "images")
POSITION_BYTES = 512 * 2**20
"""Bound of the undistortion maps that a scene keeps: 8 bytes a pixel, so one camera of 64 MP."""
NOT_REGISTERED = "structure from motion did not register it"


def open_colmap(folder: Path, protocol: Protocol) -> Scene:
    """Read a COLMAP scene; photos are only looked at (size), not decoded.

    Args:
        folder: Has the model and the photos.
        protocol: Image folder, sizes, undistortion and split.

    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    """
    model = read_model(find_model(folder))
    photos = _photo_folder(folder, protocol)
    about = read_scene_file(folder)
    names = [image.name for image in model.images]
    poses = torch.eye(4, dtype=torch.float64).repeat(len(names), 1, 1)
    matrices = np.stack([pose_matrix(image) for image in model.images])
    poses[:, :3] = torch.from_numpy(matrices)
    centres = -np.einsum("nji,nj->ni", matrices[:, :, :3], matrices[:, :, 3])
    shift = torch.from_numpy(origin_shift(centres))
    poses[:, :3, 3] += poses[:, :3, :3] @ shift

    views = _views(model, photos, poses, protocol)
    train, test = split_views(names, protocol)
    points = read_points(model, shift)
    every = len(points)
    if protocol.drop_test_points:
        points = seen_in_training(points, train)
    up, up_source = _up(about, matrices[:, :, :3], centres)
    return Scene(
        name=folder.resolve().name,
        root=folder,
        views=views,
        train=train,
        test=test,
        points=points,
        up=torch.from_numpy(up),
        units=about.units,
        shift=shift,
        left_out=_left_out(photos, names, about),
        facts=about.facts
        | {
            "adapter": "colmap",
            "model_sha256": model.sha256,
            "photos_sha256": _photos_hash(photos, names),
            "split_sha256": split_hash(names, test),
            "image_folder": photos.name,
            "up_source": up_source,
            "points": f"{len(points)} of {every}",
            **{name: version(name) for name in ("pycolmap", "pillow", "torch")},
            "opencv": version("opencv-contrib-python-headless"),
        },
    )


def _photo_folder(scene: Path, protocol: Protocol) -> Path:
    """The protocol's image folder; "photos" and "images" are two names of the full-size one."""
    wanted = [protocol.images]
    if protocol.images in FULL_SIZE_FOLDERS:
        wanted += [name for name in FULL_SIZE_FOLDERS if name != protocol.images]
    for name in wanted:
        if (scene / name).is_dir():
            return scene / name
    raise DataError(
        f"{scene}: no photos; looked for the folder {' or '.join(wanted)} "
        f"(protocol {protocol.name})"
    )


def _views(model: Model, photos: Path, poses: torch.Tensor, protocol: Protocol) -> tuple[View, ...]:
    """One view an image; images of one camera and size share their undistortion."""
    positions = TensorCache(POSITION_BYTES)
    pinholes: dict[tuple[int, int, int], tuple[torch.Tensor, tuple[int, int], Undistortion | None]]
    pinholes = {}
    several = len({image.camera_id for image in model.images}) > 1
    views = []
    for image, pose in zip(model.images, poses, strict=True):
        path = photos / image.name
        size = photo_size(path)
        key = (image.camera_id, *size)
        if key not in pinholes:
            camera = _fitted(model.reconstruction.camera(image.camera_id), size, path)
            pinholes[key] = _pinhole(camera, protocol, path)
        K, full, plan = pinholes[key]
        try:
            scaled = scaled_size(*full, protocol)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from None
        truth = Truth(
            path=path,
            photo_size=size,
            undistortion=plan,
            size=scaled,
            filter=protocol.filter,
            positions=positions,
        )
        views.append(
            View(
                name=image.name,
                camera=Camera(
                    K=scale_intrinsics(K, full, scaled),
                    world_to_camera=pose,
                    width=scaled[0],
                    height=scaled[1],
                ),
                load=truth.image,
                load_mask=truth.mask if truth.has_mask else None,
                load_depth=None
                if plan is not None
                else depth_loader(photos.parent, image.name, size, scaled),
                sensor=f"camera {image.camera_id}" if several else "",
            )
        )
    return tuple(views)


def _fitted(camera: pycolmap.Camera, size: tuple[int, int], path: Path) -> pycolmap.Camera:
    """The camera of a photo: its own, or per axis scaled where the folder is called NAME_<N>."""
    if size == (camera.width, camera.height):
        return camera
    named = re.search(r"_(\d+)$", path.parent.name)
    factor = int(named.group(1)) if named else 1
    expected = camera.width / max(factor, 1), camera.height / max(factor, 1)
    if factor > 1 and all(abs(a - b) < 1 for a, b in zip(size, expected, strict=True)):
        scaled = copy.deepcopy(camera)
        scaled.rescale(*size)
        return scaled
    raise DataError(
        f"{path}: photo is {size[0]} x {size[1]}, its camera {camera.camera_id} says "
        f"{camera.width} x {camera.height}; use the photos that this model was made from"
    )


def _pinhole(
    camera: pycolmap.Camera, protocol: Protocol, path: Path
) -> tuple[torch.Tensor, tuple[int, int], Undistortion | None]:
    """(K, size, undistortion) of a camera at full size."""
    if is_pinhole(camera):
        K = torch.from_numpy(camera.calibration_matrix())
        return K, (camera.width, camera.height), None
    try:
        plan = plan_undistortion(camera, protocol.undistort)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    return plan.K, (plan.width, plan.height), plan


def _up(about: SceneFile, rotations: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, str]:
    if about.up is not None:
        return np.array(about.up), "scene.toml"
    return up_vector(rotations, centres)


def _left_out(photos: Path, names: list[str], about: SceneFile) -> tuple[tuple[str, str], ...]:
    """Every photo that is no view, and every one that the scene file knows to be missing."""
    others = (set(list_photos(photos)) | set(about.left_out)) - set(names)
    return tuple((name, about.left_out.get(name, NOT_REGISTERED)) for name in sorted(others))


def _photos_hash(photos: Path, names: list[str]) -> str:
    """Sha256 over names and sizes in bytes; contents are hashed with the results, as scored."""
    lines = [f"{name} {(photos / name).stat().st_size}\n" for name in names]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
