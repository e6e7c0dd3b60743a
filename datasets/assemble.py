"""Makes a Scene of what an adapter has read, by a protocol's rules: one place for all adapters."""

import copy
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import read_bytes
from splatproof.base.inside import check_link
from splatproof.datasets.depth_maps import depth_loader, depth_path
from splatproof.datasets.image_cache import TensorCache
from splatproof.datasets.layout import Layout, PosedPhoto, check_layout
from splatproof.datasets.lidar import read_sweep, sample_sweeps, sweeps_of
from splatproof.datasets.photos import photo_size
from splatproof.datasets.protocol_subset import chosen_part
from splatproof.datasets.resize import scale_intrinsics, scaled_size
from splatproof.datasets.scene_frame import near_plane, origin_shift, up_vector
from splatproof.datasets.seen_split import seen_split
from splatproof.datasets.sparse_points import seen_in_training
from splatproof.datasets.splits import chosen_views, split_hash, split_views
from splatproof.datasets.truth_image import Truth
from splatproof.datasets.undistort import Undistortion, is_pinhole, plan_undistortion
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, SparsePoints, View

POSITION_BYTES = 512 * 2**20
"""Bound of the undistortion maps that a scene keeps: 8 bytes a pixel, so one camera of 64 MP."""
_WHOLE = Protocol(name="whole", source="ours")
"""Rules under which no point is left out."""
Pinholes = dict[tuple[object, ...], "Pinhole"]


def open_layout(folder: Path, layout: Layout, protocol: Protocol) -> Scene:
    """Make the Scene: views, split, shift, points and the facts of the record.

    The split is the protocol's test_names, else the one that the set ships, else every hold-th, or
    near it where `least_seen` asks for what training photos show.
    With `drop_test_points` sparse points come from no sweep of a held-out moment. Photos are only
    looked at (size), not decoded.

    Args:
        folder: The scene's folder.
        layout: What the adapter read.
        protocol: Cameras, sizes, undistortion, split and background.

    Raises: DataError naming file and fault; UsageError for a protocol that does not fit.
    """
    check_layout(layout, [*layout.description, folder][0])
    layout = chosen_part(folder, layout, protocol)
    sources = _sources(folder, layout)
    for path in (*sources, *layout.description):
        check_link(path, folder)
    photos = sorted(layout.photos, key=lambda photo: photo.name)
    names = [photo.name for photo in photos]
    twice = sorted({a for a, b in pairwise(names) if a == b})
    if not names or twice:
        fault = f"has the image {twice[0]!r} twice" if twice else "lists no images"
        raise DataError(f"{[*layout.description, folder][0]}: {fault}; expected one entry an image")
    poses = np.stack([photo.camera_to_world for photo in photos])
    centres = poses[:, :, 3]
    shift = origin_shift(centres)
    rotations = poses[:, :, :3].transpose(0, 2, 1)
    up, up_source = np.array(layout.up), layout.up_source
    if layout.up is None:
        up, up_source = up_vector(rotations, centres)
    train, test, split_source = _split(folder, photos, protocol)
    start = min((photo.time for photo in photos if photo.time is not None), default=0.0)
    views = _views(folder, layout, photos, rotations, centres - shift, shift, start, protocol)
    if protocol.least_seen:
        if split_source != "protocol":
            raise UsageError(
                f"{folder}: the data set ships its own split, and protocol {protocol.name} has "
                "least_seen; take a protocol without it"
            )
        train, test = seen_split(
            views, _moved(_points(layout, photos, train, _WHOLE)[0], shift), protocol
        )
    points, every = _points(layout, photos, train, protocol)
    return Scene(
        name=folder.resolve().name,
        root=folder,
        views=views,
        train=train,
        test=test,
        points=_moved(points, shift),
        up=torch.from_numpy(up),
        units=layout.units,
        shift=torch.from_numpy(shift),
        start=start,
        left_out=layout.left_out,
        sources=sources,
        facts=layout.facts
        | ({"cameras_sha256": _hash(folder, layout.description)} if layout.description else {})
        | {
            "adapter": layout.adapter,
            "photos_sha256": _photos_hash(photos),
            "split_sha256": split_hash(names, train, test),
            "split_source": split_source,
            "up_source": up_source,
            "points": f"{len(points)} of {every}",
            **{name: version(name) for name in ("pycolmap", "pillow", "torch")},
            "opencv": version("opencv-contrib-python-headless"),
        },
    )


def _moved(points: SparsePoints, shift: Float64[np.ndarray, "3"]) -> SparsePoints:
    """The points in the scene's frame."""
    return replace(points, positions=points.positions - torch.from_numpy(shift))


def _split(
    folder: Path, photos: Sequence[PosedPhoto], protocol: Protocol
) -> tuple[tuple[int, ...], tuple[int, ...], str]:
    shipped = [photo.split for photo in photos]
    try:
        if protocol.test_names or None in shipped:
            names, times = [photo.name for photo in photos], [photo.time for photo in photos]
            return *split_views(names, protocol, times), "protocol"
        train = tuple(i for i, split in enumerate(shipped) if split == "train")
        test = tuple(i for i, split in enumerate(shipped) if split == "test")
        if not train:
            raise DataError("the data set's split has no training view")
        return *chosen_views(train, test, protocol), "data set"
    except DataError as error:  # which of a suite's scenes a protocol does not fit
        raise DataError(f"{folder}: {error}") from None


def _points(
    layout: Layout, photos: Sequence[PosedPhoto], train: tuple[int, ...], protocol: Protocol
) -> tuple[SparsePoints, int]:
    """(points in the original frame, how many there would be without the protocol's rule)."""
    points, sweeps = layout.points, layout.sweeps
    if points is not None:
        used = seen_in_training(points, train) if protocol.drop_test_points else points
        return used, len(points)
    if protocol.drop_test_points:
        trained = {photos[i].time for i in train}
        sweeps = [sweep for sweep in sweeps if sweep.time in trained]
    points = sample_sweeps(sweeps)
    return points, len(points)


def _views(
    folder: Path,
    layout: Layout,
    photos: Sequence[PosedPhoto],
    rotations: Float64[np.ndarray, "n 3 3"],
    centres: Float64[np.ndarray, "n 3"],
    shift: Float64[np.ndarray, "3"],
    start: float,
    protocol: Protocol,
) -> tuple[View, ...]:
    """One view a photo; photos of equal cameras and size share their undistortion.

    A view's loaders hold the paths of its own files alone, and none of them that of another's.
    """
    positions = TensorCache(POSITION_BYTES)
    pinholes: Pinholes = {}
    poses = np.tile(np.eye(4), (len(photos), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", rotations, centres)
    sweeps = sweeps_of(layout.sweeps, [photo.time for photo in photos])
    near = near_plane(centres)
    views = []
    for photo, pose, sweep in zip(photos, torch.from_numpy(poses), sweeps, strict=True):
        size = photo_size(photo.path)
        pinhole = _pinhole(photo, size, protocol, pinholes)
        scaled = pinhole.size
        truth = Truth(
            path=photo.path,
            photo_size=size,
            undistortion=pinhole.undistortion,
            shrunk=pinhole.shrunk,
            size=scaled,
            filter=protocol.filter,
            positions=positions,
            background=protocol.background if layout.flatten else None,
            valid=photo.valid,
            sky=photo.sky,
        )
        views.append(
            View(
                name=photo.name,
                camera=Camera(
                    K=pinhole.K,
                    world_to_camera=pose,
                    width=scaled[0],
                    height=scaled[1],
                    near=near,
                ),
                load=truth,
                load_mask=truth.mask if truth.has_mask else None,
                load_depth=None
                if pinhole.undistortion
                else depth_loader(folder, photo.name, size, scaled),
                load_sky=truth.sky_mask if photo.sky else None,
                load_sweep=partial(read_sweep, sweep, shift, start) if sweep else None,
                sweep_time=sweep.time - start if sweep else None,
                load_moving=partial(truth.moving_masks, photo.moving) if photo.moving else None,
                time=None if photo.time is None else photo.time - start,
                sensor=photo.sensor,
            )
        )
    return tuple(views)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pinhole:
    """What a photo's camera becomes under a protocol."""

    K: Float[Tensor, "3 3"]
    """Intrinsics of the truth image, in its pixels."""
    size: tuple[int, int]
    """(width, height) of the truth image."""
    undistortion: Undistortion | None
    shrunk: tuple[int, int]
    """Size of the photo when it is undistorted."""


def _pinhole(
    photo: PosedPhoto, size: tuple[int, int], protocol: Protocol, known: Pinholes
) -> Pinhole:
    """The pinhole of a photo at its file's size; equal cameras share it."""
    camera = photo.camera
    key = (camera.model_name, camera.width, camera.height, *camera.params.tolist(), *size)
    if key in known:
        return known[key]
    if size != (camera.width, camera.height):
        expected = camera.width / photo.factor, camera.height / photo.factor
        # a copy has whole pixels: each side is within one of the exact quotient
        near = all(abs(a - b) < 1 for a, b in zip(size, expected, strict=True))
        if photo.factor == 1 or not near:
            raise DataError(
                f"{photo.path}: photo is {size[0]} x {size[1]}, its camera says "
                f"{camera.width} x {camera.height}; use the photos that were calibrated"
            )
        camera = copy.deepcopy(camera)
        camera.rescale(*size)
    try:
        if is_pinhole(camera):
            plan, K, full = None, torch.from_numpy(camera.calibration_matrix()), size
        else:
            plan = plan_undistortion(camera, protocol.undistort)
            K, full = plan.K, (plan.width, plan.height)
        scaled = scaled_size(*full, protocol)
    except (DataError, UsageError) as error:
        raise type(error)(f"{photo.path}: {error}") from None
    K, shrunk = scale_intrinsics(K, full, scaled), size
    if plan is not None and protocol.undistort_at == "scaled":
        plan = replace(plan, K=K, width=scaled[0], height=scaled[1])
        shrunk = tuple(max(1, round(a * b / c)) for a, b, c in zip(size, scaled, full, strict=True))
    known[key] = Pinhole(K=K, size=scaled, undistortion=plan, shrunk=(shrunk[0], shrunk[1]))
    return known[key]


def _sources(folder: Path, layout: Layout) -> tuple[Path, ...]:
    """Every file whose pixels, depths or points the scene's views and points are made of."""
    files = {sweep.path for sweep in layout.sweeps}
    for photo in layout.photos:
        depth = depth_path(folder, photo.name)
        files |= {photo.path, *filter(None, (photo.valid, photo.sky))}
        files |= {depth} if depth.is_file() else set()
        files |= {mask for mask in photo.moving.values() if isinstance(mask, Path)}
    return tuple(sorted(files))


def _hash(folder: Path, files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        data = read_bytes(path)
        name = Path(os.path.relpath(path, folder)).as_posix()
        digest.update(f"{name} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def _photos_hash(photos: Sequence[PosedPhoto]) -> str:
    """Sha256 over names and sizes in bytes; contents are hashed with the results, as scored."""
    lines = [f"{photo.name} {photo.path.stat().st_size}\n" for photo in photos]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
