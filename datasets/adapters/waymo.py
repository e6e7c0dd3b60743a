"""Waymo sequences as exported by the preprocessors of drivestudio (OmniRe) and of PVG.

Both give poses of the vehicle (x forward, y left, z up) in the sequence's world, in metres.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.datasets.adapters import driving
from splatproof.datasets.adapters.posed import checked_pose, find_photo, pinhole_camera, positive
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.colmap_library import pycolmap
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.moving_masks import moving_masks
from splatproof.datasets.photos import list_photos, photo_size
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

CAMERAS = ("front", "front_left", "front_right", "side_left", "side_right")
"""Names of the cameras 0 to 4, which a protocol's `sensors` chooses from."""
OPENCV_TO_VEHICLE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Right, down, forward in the axes of Waymo's cameras: x forward, y left, z up."""
ROOF = (1.43, 0.0, 2.184)
"""Where the LiDAR on the roof is in the vehicle's frame, in metres: its extrinsic calibration, the same in
the data set's sequences (Sun et al. 2020, Waymo Open Dataset). It has most of a sweep's points."""
SUFFIXES = (".jpg", ".png")
MASKS = {"vehicles": "vehicle", "people": "human"}
"""Folders of drivestudio's masks; its third one, all, is these two together."""


def recognises_drivestudio(folder: Path) -> bool:
    """Whether a folder is a sequence exported by drivestudio."""
    return (folder / "ego_pose").is_dir() and (folder / "extrinsics").is_dir()


def open_drivestudio(folder: Path, protocol: Protocol) -> Scene:
    """Read ego_pose, extrinsics, intrinsics, images; lidar, sky and dynamic masks where they are.

    Intrinsics are fx, fy, cx, cy, k1, k2, p1, p2, k3; photos are undistorted by the protocol's
    rule. LiDAR rows are 14 float32 in the vehicle's frame: origin, point, 8 labels; several
    LiDARs share a file, and the sweep's origin is where most rays start. What moves faster than 1 m/s is masked: by rectangles around its box (dynamic_masks) or, where they are, by
    segments inside those (fine_dynamic_masks). Boxes (instances) are not read: nothing needs them.

    Args:
        folder: The sequence's folder.
        protocol: Cameras and clips that are used, image sizes, undistortion, held-out views.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Chen et al. 2025 (OmniRe), release drivestudio: datasets/waymo, datasets/base/pixel_source.py.
    """
    frames = driving.frame_names(folder / "ego_pose")
    fine, coarse = folder / "fine_dynamic_masks", folder / "dynamic_masks"
    masks = fine if fine.is_dir() else coarse
    poses = [folder / "ego_pose" / f"{frame}.txt" for frame in frames]
    vehicle = [driving.homogeneous(_pose(path)) for path in poses]
    photos, files = [], list(poses)
    for camera, sensor in enumerate(CAMERAS):
        paths = [folder / name / f"{camera}.txt" for name in ("intrinsics", "extrinsics")]
        if not any(path.is_file() for path in paths):
            continue
        numbers, mount = driving.read_numbers(paths[0], 9), _pose(paths[1])
        files += paths
        to_vehicle = np.concatenate([mount[:, :3] @ OPENCV_TO_VEHICLE, mount[:, 3:]], axis=1)
        for index, frame in enumerate(frames):
            stem = folder / "images" / f"{frame}_{camera}"
            path = find_photo(stem, SUFFIXES, lambda: str(folder / "ego_pose"))
            sky = folder / "sky_masks" / f"{frame}_{camera}.png"
            photos.append(
                PosedPhoto(
                    name=path.relative_to(folder).as_posix(),
                    path=path,
                    camera=_camera(numbers, photo_size(path), paths[0]),
                    camera_to_world=(vehicle[index] @ driving.homogeneous(to_vehicle))[:3],
                    sky=sky if sky.is_file() else None,
                    moving=moving_masks(masks, f"{frame}_{camera}.png", MASKS),
                    time=index * driving.FRAME_SECONDS,
                    sensor=sensor,
                )
            )
    sweeps = driving.present(frames, lambda frame: folder / "lidar" / f"{frame}.bin")
    layout = Layout(
        adapter="drivestudio",
        photos=photos,
        description=files or [folder / "ego_pose"],
        sweeps=[
            driving.sweep(
                path, i * driving.FRAME_SECONDS, vehicle[i], columns=14, first=3, sensor=0
            )
            for i, path in sweeps
        ],
        up=driving.UP,
        units="metres",
        left_out=_others(folder, ["images"], photos),
        facts={"sweeps": f"{len(sweeps)} of {len(frames)} frames"},
    )
    return open_layout(folder, layout, protocol)


def recognises_pvg(folder: Path) -> bool:
    """Whether a folder is a sequence exported by PVG."""
    return all((folder / name).is_dir() for name in ("calib", "pose", "image_0"))


def open_pvg(folder: Path, protocol: Protocol) -> Scene:
    """Read calib, pose, image_0 to image_4, and velodyne and sky_0 to sky_4 where they are.

    A frame's calib has P0 to P4 and Tr_velo_to_cam_0 to _4, vehicle to camera with OpenCV axes;
    the export drops the distortion. LiDAR rows are 6 float32 in the vehicle's frame; the export
    drops which LiDAR measured a point, so a sweep's origin is that of the one on the roof.

    Args:
        folder: The sequence's folder.
        protocol: Cameras and clips that are used, image sizes, and which views are held out.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Chen et al. 2023 (PVG), release: scripts/waymo_converter.py, scene/waymo_loader.py.
    """
    frames = driving.frame_names(folder / "calib")
    calibs = [folder / "calib" / f"{frame}.txt" for frame in frames]
    poses = [folder / "pose" / path.name for path in calibs]
    vehicle = [driving.homogeneous(_pose(path)) for path in poses]
    cameras = [i for i in range(len(CAMERAS)) if (folder / f"image_{i}").is_dir()]
    photos = []
    for index, calib in enumerate(calibs):
        table = driving.read_table(calib)
        for camera in cameras:
            K = driving.entry(calib, table, [f"P{camera}"], 3, 4)
            matrix = driving.entry(calib, table, [f"Tr_velo_to_cam_{camera}"], 3, 4)
            mount = driving.homogeneous(checked_pose(matrix, f"{calib}: Tr_velo_to_cam_{camera}"))
            path = find_photo(
                folder / f"image_{camera}" / calib.stem, SUFFIXES, lambda: str(folder / "calib")
            )
            fx, fy = (positive(float(K[i, i]), str(calib), f"P{camera}") for i in (0, 1))
            sky = folder / f"sky_{camera}" / f"{calib.stem}.png"
            photos.append(
                PosedPhoto(
                    name=path.relative_to(folder).as_posix(),
                    path=path,
                    camera=pinhole_camera(
                        *photo_size(path), fx, fy, float(K[0, 2]), float(K[1, 2])
                    ),
                    camera_to_world=(vehicle[index] @ np.linalg.inv(mount))[:3],
                    sky=sky if sky.is_file() else None,
                    time=index * driving.FRAME_SECONDS,
                    sensor=CAMERAS[camera],
                )
            )
    sweeps = driving.present(frames, lambda frame: folder / "velodyne" / f"{frame}.bin")
    layout = Layout(
        adapter="pvg",
        photos=photos,
        description=[*calibs, *poses] or [folder / "calib"],
        sweeps=[
            driving.sweep(
                path, i * driving.FRAME_SECONDS, vehicle[i], columns=6, first=0, sensor=ROOF
            )
            for i, path in sweeps
        ],
        up=driving.UP,
        units="metres",
        left_out=_others(folder, [f"image_{i}" for i in cameras], photos),
        facts={"sweeps": f"{len(sweeps)} of {len(frames)} frames"},
    )
    return open_layout(folder, layout, protocol)


def _pose(path: Path) -> np.ndarray:
    return checked_pose(driving.read_numbers(path, 16).reshape(4, 4), str(path))


def _camera(numbers: np.ndarray, size: tuple[int, int], path: Path) -> pycolmap.Camera:
    fx, fy = (positive(float(value), str(path), "focal length") for value in numbers[:2])
    cx, cy, k1, k2, p1, p2, k3 = numbers[2:].tolist()
    if not any(numbers[4:]):
        return pinhole_camera(*size, fx, fy, cx, cy)
    params = [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    return pycolmap.Camera(model="FULL_OPENCV", width=size[0], height=size[1], params=params)


def _others(
    folder: Path, parts: Sequence[str], photos: Sequence[PosedPhoto]
) -> tuple[tuple[str, str], ...]:
    """Photos that no frame and camera has."""
    if not photos:
        raise DataError(f"{folder}: has no frame with a camera; expected poses and calibrations")
    known = {photo.name for photo in photos}
    names = [f"{part}/{name}" for part in parts for name in list_photos(folder / part)]
    return tuple((name, "no pose or no camera") for name in names if name not in known)
