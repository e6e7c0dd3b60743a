"""KITTI: raw drives and tracking sequences; the colour cameras 02 and 03, rectified.

The world is east, north, up from the first frame's position, in metres, as in pykitti.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.datasets.adapters import driving
from splatproof.datasets.adapters.kitti_boxes import read_labels, read_tracklets
from splatproof.datasets.adapters.posed import checked_pose, pinhole_camera, positive
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.boxes import Box, covered, in_motion
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.moving_masks import KINDS
from splatproof.datasets.photos import list_photos, photo_size
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

EARTH_RADIUS = 6378137.0
"""Radius in metres of the devkit's Mercator projection."""
CAMERAS = ("02", "03")
RAW_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """Where sensors sit on the car."""

    K: dict[str, Float64[np.ndarray, "3 3"]]
    to_imu: dict[str, Float64[np.ndarray, "4 4"]]
    """Motion to the IMU's frame from each camera's (OpenCV axes), from "lidar", and from "rectified", the
    frame in which labels lie."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """A sequence as files."""

    folder: Path
    frames: Sequence[str]
    """Stems of the photos."""
    images: dict[str, Path]
    """Folder of each camera's photos."""
    sky: dict[str, Path]
    sweeps: Path
    times: Sequence[float]
    imu: Sequence[Float64[np.ndarray, "4 4"]]
    rig: Rig
    labels: Path
    """Boxes; the file may be missing."""
    description: Sequence[Path]


def recognises_raw(folder: Path) -> bool:
    """Whether a folder is a drive of KITTI raw."""
    return (folder / "oxts" / "data").is_dir() and (folder / "image_02" / "data").is_dir()


def recognises_tracking(folder: Path) -> bool:
    """Whether a folder is image_02/<sequence> of KITTI tracking."""
    folder = folder.resolve()
    beside = [folder.parent.parent / name / f"{folder.name}.txt" for name in ("calib", "oxts")]
    return folder.parent.name == "image_02" and any(path.is_file() for path in beside)


def open_raw(folder: Path, protocol: Protocol) -> Scene:
    """Read a drive (<date>_drive_<n>_sync); the calibration files stand in the date's folder.

    Where it has tracklet_labels.xml, masks of what moves are outlines of its boxes. A sweep has its
    frame's time, like the pose that it is placed by: the scanner triggers the cameras as it faces forward, so
    the dates of its own, velodyne_points/timestamps*.txt, are not read.

    Args:
        folder: The drive's folder, with image_02, image_03, oxts and velodyne_points.
        protocol: Cameras and clips that are used, image sizes, and which views are held out.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Geiger et al. 2013, "Vision meets Robotics", and its devkit; pykitti 0.3.
    """
    paths = [folder.resolve().parent / name for name in RAW_CALIBRATIONS]
    cameras, *mounts = (driving.read_table(path) for path in paths)
    to_camera, to_lidar = (
        np.concatenate([driving.entry(p, t, ["R"], 3, 3), driving.entry(p, t, ["T"], 3, 1)], axis=1)
        for p, t in zip(paths[1:], mounts, strict=True)
    )
    rectify = driving.entry(paths[0], cameras, ["R_rect_00"], 3, 3)
    projections = {
        name: driving.entry(paths[0], cameras, [f"P_rect_{name}"], 3, 4) for name in CAMERAS
    }
    stamps = folder / "image_02" / "timestamps.txt"
    images = {name: folder / f"image_{name}" / "data" for name in CAMERAS}
    frames = [Path(name).stem for name in list_photos(images["02"])]
    oxts = [folder / "oxts" / "data" / f"{frame}.txt" for frame in frames]
    drive = Drive(
        folder=folder,
        frames=frames,
        images=images,
        sky={name: folder / f"sky_{name}" / "data" for name in CAMERAS},
        sweeps=folder / "velodyne_points" / "data",
        times=_times(stamps, len(frames), images["02"]),
        imu=imu_poses(np.stack([driving.read_numbers(path, 30) for path in oxts])[:, :6]),
        rig=_rig(projections, rectify, to_camera, to_lidar, paths[0]),
        labels=folder / "tracklet_labels.xml",
        description=[*paths, stamps, *oxts],
    )
    return _open(drive, "kitti-raw", protocol)


def open_tracking(folder: Path, protocol: Protocol) -> Scene:
    """Read training/image_02/<sequence>; its calib, oxts, velodyne, sky_02 and label_02 stand beside.

    Where it has label_02/<sequence>.txt, masks of what moves are outlines of its boxes.

    Poses are the set's own: PVG and MARS turn the cameras by a further hand-tuned degree.

    Args:
        folder: The sequence's folder of photos, training/image_02/<sequence>.
        protocol: Cameras and clips that are used, image sizes, and which views are held out.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: KITTI tracking benchmark, devkit; Chen et al. 2023 (PVG), scene/kittimot_loader.py.
    """
    root, sequence = folder.resolve().parents[1], folder.resolve().name
    calib, oxts = root / "calib" / f"{sequence}.txt", root / "oxts" / f"{sequence}.txt"
    table = driving.read_table(calib)
    projections = {name: driving.entry(calib, table, [f"P{int(name)}"], 3, 4) for name in CAMERAS}
    images = {name: root / f"image_{name}" / sequence for name in CAMERAS}
    frames = [Path(name).stem for name in list_photos(folder)]
    lines = driving.read_text(oxts).splitlines()
    if len(lines) != len(frames) or any(len(line.split()) != 30 for line in lines):
        raise DataError(
            f"{oxts}: has {len(lines)} lines, expected one of 30 numbers for each of "
            f"{len(frames)} photos in {folder}"
        )
    drive = Drive(
        folder=folder,
        frames=frames,
        images=images,
        sky={name: root / f"sky_{name}" / sequence for name in CAMERAS},
        sweeps=root / "velodyne" / sequence,
        times=[i * driving.FRAME_SECONDS for i in range(len(frames))],
        imu=imu_poses(driving.read_numbers(oxts, 30 * len(lines)).reshape(-1, 30)[:, :6]),
        rig=_rig(
            projections,
            driving.entry(calib, table, ["R_rect", "R0_rect"], 3, 3),
            driving.entry(calib, table, ["Tr_velo_cam", "Tr_velo_to_cam"], 3, 4),
            driving.entry(calib, table, ["Tr_imu_velo", "Tr_imu_to_velo"], 3, 4),
            calib,
        ),
        labels=root / "label_02" / f"{sequence}.txt",
        description=[calib, oxts],
    )
    return _open(drive, "kitti-tracking", protocol)


def imu_poses(rows: Float64[np.ndarray, "n 6"]) -> list[Float64[np.ndarray, "4 4"]]:
    """IMU to world: Rz(yaw) Ry(pitch) Rx(roll), Mercator position less the first frame's.

    Args:
        rows: Latitude and longitude in degrees, altitude in metres, roll, pitch, yaw in radians.

    Source: Geiger et al. 2013, devkit: convertOxtsToPose.
    """
    latitude, longitude, altitude, *angles = rows.T
    scale = np.cos(np.radians(latitude[0])) * EARTH_RADIUS
    east = scale * np.radians(longitude)
    north = scale * np.log(np.tan(np.pi * (90 + latitude) / 360))
    places = np.stack([east, north, altitude], axis=1)
    poses = []
    for place, (roll, pitch, yaw) in zip(places - places[0], np.stack(angles, axis=1), strict=True):
        (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        poses.append(driving.homogeneous(np.c_[about_z @ about_y @ about_x, place]))
    return poses


def _rig(
    projections: dict[str, Float64[np.ndarray, "3 4"]],
    rectify: Float64[np.ndarray, "3 3"],
    to_camera: Float64[np.ndarray, "3 4"],
    to_lidar: Float64[np.ndarray, "3 4"],
    path: Path,
) -> Rig:
    """Sensors from calibration: x_image = P R_rect T_velo_cam T_imu_velo x_imu.

    A camera is K [I | t] = P of the rectified frame: t = K^-1 P e4.
    """
    rotation = checked_pose(np.c_[rectify, np.zeros(3)], f"{path}: rectification")
    lidar = driving.homogeneous(checked_pose(to_lidar, f"{path}: IMU to LiDAR"))
    camera = driving.homogeneous(checked_pose(to_camera, f"{path}: LiDAR to camera"))
    rectified = driving.homogeneous(rotation) @ camera @ lidar
    rig = Rig(K={}, to_imu={"lidar": np.linalg.inv(lidar), "rectified": np.linalg.inv(rectified)})
    for name, projection in projections.items():
        for i in (0, 1):
            positive(float(projection[i, i]), str(path), f"focal length of camera {name}")
        moved = np.c_[np.eye(3), np.linalg.solve(projection[:, :3], projection[:, 3])]
        rig.K[name] = projection[:, :3]
        rig.to_imu[name] = np.linalg.inv(driving.homogeneous(moved) @ rectified)
    return rig


def _times(path: Path, count: int, photos: Path) -> list[float]:
    """Seconds since the first of a file of dates with nanoseconds."""
    lines = driving.read_text(path).split("\n")
    lines = [line for line in lines if line.strip()]
    try:
        # datetime reads microseconds at most
        stamps = [datetime.datetime.fromisoformat(line[:26]) for line in lines]
    except ValueError as error:
        raise DataError(f"{path}: not a file of dates ({error})") from None
    if len(stamps) != count:
        raise DataError(
            f"{path}: has {len(stamps)} dates, but there are {count} photos in {photos}"
        )
    return [(stamp - stamps[0]).total_seconds() for stamp in stamps]


def _moving(drive: Drive) -> dict[str, list[list[Box]]] | None:
    """Boxes in motion, by kind and frame; None where the drive has no labels."""
    if not drive.labels.is_file():
        return None
    read, frame = (
        (read_tracklets, "lidar") if drive.labels.suffix == ".xml" else (read_labels, "rectified")
    )
    boxes = read(drive.labels, [imu @ drive.rig.to_imu[frame] for imu in drive.imu])
    moving: dict[str, list[list[Box]]] = {kind: [[] for _ in drive.frames] for kind in KINDS}
    for box in in_motion(boxes, drive.times):
        moving[box.kind][box.frame].append(box)
    return moving


def _open(drive: Drive, adapter: str, protocol: Protocol) -> Scene:
    photos, left_out = [], []
    moving = _moving(drive)
    for name in CAMERAS:
        K, folder = drive.rig.K[name], drive.images[name]
        for index, frame in enumerate(drive.frames):
            path = folder / f"{frame}.png"
            pose, size = drive.imu[index] @ drive.rig.to_imu[name], photo_size(path)
            masks = {
                kind: partial(covered, boxes[index], K, np.linalg.inv(pose), size)
                for kind, boxes in (moving or {}).items()
            }
            sky = drive.sky[name] / f"{frame}.png"
            photos.append(
                PosedPhoto(
                    name=f"image_{name}/{frame}.png",
                    path=path,
                    camera=pinhole_camera(
                        *size,
                        *(float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))),
                    ),
                    camera_to_world=pose[:3],
                    sky=sky if sky.is_file() else None,
                    moving=masks,
                    time=drive.times[index],
                    sensor=f"image_{name}",
                )
            )
        extra = {Path(n).stem for n in list_photos(folder)} - set(drive.frames)
        left_out += [
            (f"image_{name}/{stem}.png", "no photo of camera 02") for stem in sorted(extra)
        ]
    files = driving.present(drive.frames, lambda frame: drive.sweeps / f"{frame}.bin")
    layout = Layout(
        adapter=adapter,
        photos=photos,
        description=[*drive.description, *([] if moving is None else [drive.labels])],
        sweeps=[
            driving.sweep(
                path, drive.times[i], drive.imu[i] @ drive.rig.to_imu["lidar"], columns=4, first=0
            )
            for i, path in files
        ],
        up=driving.UP,
        units="metres",
        left_out=tuple(left_out),
        facts={"sweeps": f"{len(files)} of {len(drive.frames)} frames"},
    )
    return open_layout(drive.folder, layout, protocol)
