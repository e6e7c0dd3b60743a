"""What every door shares: from photos with cameras in OpenCV axes to a Scene."""

import copy
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from splatbench.datasets.frame import origin_shift, up_vector
from splatbench.datasets.images import TensorCache
from splatbench.datasets.photos import photo_size
from splatbench.datasets.resize import scale_intrinsics, scaled_size
from splatbench.datasets.splits import split_hash, split_views
from splatbench.datasets.truth import Truth
from splatbench.datasets.undistort import Undistortion, is_pinhole, plan_undistortion
from splatbench.reference.camera import Camera
from splatbench.reference.errors import DataError, UsageError
from splatbench.reference.protocol import Protocol
from splatbench.reference.scene import Scene, SparsePoints, View

POSITION_BYTES = 512 * 2**20
"""Bound of the undistortion maps that a scene keeps."""
RIGID = 1e-3
"""How far R R^T may be from the identity: files hold float32 or few digits."""
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])
"""Camera axes right, up, back to right, down, forward."""
Pinholes = dict[tuple[object, ...], tuple[Tensor, tuple[int, int], Undistortion | None]]


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
    scaled: bool = False
    """The file may be a smaller copy of the calibrated photo, of about the same aspect."""
    time: float | None = None
    sensor: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """A data set's scene as read from its files."""

    adapter: str
    photos: Sequence[PosedPhoto]
    description: Sequence[Path]
    """Files that say where the cameras are; their bytes are hashed for the record."""
    points: Float64[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    colours: np.ndarray | None = None
    """uint8 RGB of the points; None: mid grey."""
    up: tuple[float, float, float] | None = None
    """Unit vector against gravity where the format fixes it; None: guessed from the cameras."""
    units: str = "sfm"
    left_out: tuple[tuple[str, str], ...] = ()
    flatten: bool = False
    """Transparent photos are laid on the protocol's background instead of refused."""


def pinhole_camera(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> pycolmap.Camera:
    """An undistorted camera; all in pixels, pixel centres at .5."""
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
    except (TypeError, ValueError):
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


def positive(value: object, where: str, name: str) -> float:
    """A finite number above 0. Raises: DataError naming the file and the field."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise DataError(f"{where}: {name} is {value!r}, expected a number above 0")
    return float(value)


def open_layout(folder: Path, layout: Layout, protocol: Protocol) -> Scene:
    """Make the Scene: views, split, shift, points and the facts of the record.

    The split is the protocol's test_names, else the one that the set ships, else every hold-th.

    Args:
        folder: The scene's folder.
        layout: What the adapter read.
        protocol: Sizes, undistortion, split and background.

    Raises: DataError naming file and fault; UsageError for a protocol that does not fit.
    """
    photos = sorted(layout.photos, key=lambda photo: photo.name)
    names = [photo.name for photo in photos]
    twice = sorted({a for a, b in pairwise(names) if a == b})
    if not names or twice:
        fault = f"has the image {twice[0]!r} twice" if twice else "lists no images"
        raise DataError(f"{layout.description[0]}: {fault}; expected one entry an image")
    poses = np.stack([photo.camera_to_world for photo in photos])
    centres = poses[:, :, 3]
    shift = origin_shift(centres)
    rotations = poses[:, :, :3].transpose(0, 2, 1)
    up, up_source = np.array(layout.up), "data set"
    if layout.up is None:
        up, up_source = up_vector(rotations, centres)
    train, test, split_source = _split(photos, names, protocol)
    return Scene(
        name=folder.resolve().name,
        root=folder,
        views=_views(photos, rotations, centres - shift, protocol, layout.flatten),
        train=train,
        test=test,
        points=_points(layout, shift),
        up=torch.from_numpy(up),
        units=layout.units,
        shift=torch.from_numpy(shift),
        left_out=layout.left_out,
        facts={
            "adapter": layout.adapter,
            "cameras_sha256": _hash(folder, layout.description),
            "photos_sha256": _photos_hash(photos),
            "split_sha256": split_hash(names, test),
            "split_source": split_source,
            "up_source": up_source,
            "points": str(len(layout.points)),
            **{name: version(name) for name in ("pycolmap", "pillow", "torch")},
            "opencv": version("opencv-contrib-python-headless"),
        },
    )


def _split(
    photos: Sequence[PosedPhoto], names: list[str], protocol: Protocol
) -> tuple[tuple[int, ...], tuple[int, ...], str]:
    shipped = [photo.split for photo in photos]
    if protocol.test_names or None in shipped:
        return *split_views(names, protocol), "protocol"
    train = tuple(i for i, split in enumerate(shipped) if split == "train")
    test = tuple(i for i, split in enumerate(shipped) if split == "test")
    if not train:
        raise DataError(f"{photos[0].path.parent}: the data set's split has no training view")
    return train, test, "data set"


def _views(
    photos: Sequence[PosedPhoto],
    rotations: Float64[np.ndarray, "n 3 3"],
    centres: Float64[np.ndarray, "n 3"],
    protocol: Protocol,
    flatten: bool,
) -> tuple[View, ...]:
    positions = TensorCache(POSITION_BYTES)
    pinholes: Pinholes = {}
    poses = np.tile(np.eye(4), (len(photos), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", rotations, centres)
    views = []
    for photo, pose in zip(photos, torch.from_numpy(poses), strict=True):
        size = photo_size(photo.path)
        K, full, plan = _pinhole(photo, size, protocol, pinholes)
        try:
            scaled = scaled_size(*full, protocol)
        except UsageError as error:
            raise UsageError(f"{photo.path}: {error}") from None
        truth = Truth(
            path=photo.path,
            photo_size=size,
            undistortion=plan,
            size=scaled,
            filter=protocol.filter,
            positions=positions,
            background=protocol.background if flatten else None,
        )
        views.append(
            View(
                name=photo.name,
                camera=Camera(
                    K=scale_intrinsics(K, full, scaled),
                    world_to_camera=pose,
                    width=scaled[0],
                    height=scaled[1],
                ),
                load=truth.image,
                load_mask=truth.mask if truth.has_mask else None,
                time=photo.time,
                sensor=photo.sensor,
            )
        )
    return tuple(views)


def _pinhole(
    photo: PosedPhoto, size: tuple[int, int], protocol: Protocol, known: Pinholes
) -> tuple[Float[Tensor, "3 3"], tuple[int, int], Undistortion | None]:
    """(K, size, undistortion) of a photo at its file's size; equal cameras share them."""
    camera = photo.camera
    key = (camera.model_name, camera.width, camera.height, *camera.params.tolist(), *size)
    if key in known:
        return known[key]
    if size != (camera.width, camera.height):
        # a smaller copy has whole pixels: each side is within one of the exact quotient
        ratio = camera.width / size[0]
        if not (photo.scaled and ratio > 1 and abs(camera.height / ratio - size[1]) <= 1):
            raise DataError(
                f"{photo.path}: photo is {size[0]} x {size[1]}, its camera says "
                f"{camera.width} x {camera.height}; use the photos that were calibrated"
            )
        camera = copy.deepcopy(camera)
        camera.rescale(*size)
    if is_pinhole(camera):
        known[key] = torch.from_numpy(camera.calibration_matrix()), size, None
        return known[key]
    try:
        plan = plan_undistortion(camera, protocol.undistort)
    except DataError as error:
        raise DataError(f"{photo.path}: {error}") from None
    known[key] = plan.K, (plan.width, plan.height), plan
    return known[key]


def _points(layout: Layout, shift: Float64[np.ndarray, "3"]) -> SparsePoints:
    count = len(layout.points)
    colours = np.full((count, 3), 128, np.uint8) if layout.colours is None else layout.colours
    return SparsePoints(
        positions=torch.from_numpy(layout.points - shift),
        colours=torch.from_numpy(colours),
        track_starts=torch.zeros(count + 1, dtype=torch.int64),
        track_views=torch.zeros(0, dtype=torch.int64),
    )


def _hash(folder: Path, files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        data = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def _photos_hash(photos: Sequence[PosedPhoto]) -> str:
    """Sha256 over names and sizes in bytes; contents are hashed with the results, as scored."""
    lines = [f"{photo.name} {photo.path.stat().st_size}\n" for photo in photos]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def find_photo(stem: Path, suffixes: Sequence[str], listed_in: Callable[[], str]) -> Path:
    """The image file of a stem with one of the suffixes. Raises: DataError naming the stem."""
    for suffix in suffixes:
        path = stem.with_name(stem.name + suffix)
        if path.is_file():
            return path
    raise DataError(
        f"{stem}: photo is missing with any of {', '.join(suffixes)}, but {listed_in()} lists it"
    )
