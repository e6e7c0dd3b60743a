import math
import pickle

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.adapter_checks import (
    hard_links,
    opens_in_bounds,
    protocol,
    refused,
    sky,
    sweep,
    tenths,
    without,
)
from helpers.posed_scenes import blob, worst_error
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene

RADIUS = 6378137.0
LATITUDE, LONGITUDE, ALTITUDE = 49.0095, 8.4359, 113.0
P = {
    "02": np.array([[80.0, 0, 50, 4], [0, 84, 34, 0.2], [0, 0, 1, 0.003]]),
    "03": np.array([[80.0, 0, 50, -36], [0, 84, 34, 0.3], [0, 0, 1, 0.002]]),
}
RECTIFY = Rotation.from_euler("xyz", [0.01, -0.02, 0.005]).as_matrix()
TO_CAMERA = np.array([[0.0, -1, 0, 0.02], [0, 0, -1, -0.06], [1, 0, 0, -0.33]])
TO_CAMERA[:, :3] = Rotation.from_euler("xyz", [0.01, 0.02, 0.01]).as_matrix() @ TO_CAMERA[:, :3]
TO_LIDAR = np.c_[Rotation.from_euler("xyz", [0.001, -0.002, 0.014]).as_matrix(), [-0.8, 0.32, -0.8]]
AHEAD = np.array([[9.0, 1.0, 0.3], [12.0, -1.5, -0.5], [10.0, 0.4, 0.8]])
"""Points in the first frame's IMU axes: forward, left, up."""


def full(matrix):
    return np.concatenate([matrix, [[0.0, 0, 0, 1]]])


def oxts(i):
    """30 numbers of frame i: position, angles, and what nobody reads."""
    turn = [0.01 * math.sin(i), 0.02 * math.cos(i), 0.3 + 0.02 * math.sin(i)]
    return [LATITUDE + 1e-6 * (i % 9), LONGITUDE + 2e-6 * (i % 9), ALTITUDE + 0.01 * i, *turn] + [
        0.0
    ] * 24


def imu(i):
    """IMU to world by the devkit's formula, less the first frame's position."""
    places = []
    for lat, lon, alt, *_ in (oxts(0), oxts(i)):
        s = math.cos(math.radians(LATITUDE))
        y = s * RADIUS * math.log(math.tan(math.pi * (90 + lat) / 360))
        places.append([s * RADIUS * math.radians(lon), y, alt])
    roll, pitch, yaw = oxts(i)[3:6]
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    return full(np.c_[rotation, np.subtract(places[1], places[0])])


POINTS = np.c_[AHEAD, np.ones(3)] @ imu(0)[:3].T


def pixel(i, camera, point):
    """The devkit's chain from the world to the rectified image."""
    lidar = full(TO_LIDAR) @ np.linalg.inv(imu(i)) @ [*point, 1.0]
    x, y, z = P[camera] @ full(np.c_[RECTIFY, np.zeros(3)]) @ full(TO_CAMERA) @ lidar
    return np.array([x / z, y / z])


def scan(path, i):
    """Reflectance beside each point, in the LiDAR's axes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    inside = np.c_[POINTS, np.ones(3)] @ (full(TO_LIDAR) @ np.linalg.inv(imu(i))).T
    np.c_[inside[:, :3], np.zeros(3)].astype(np.float32).tofile(path)


def text(values):
    return " ".join(f"{x:.12e}" for x in np.asarray(values).ravel())


def raw(root, *, frames=4, paint=True):
    """<date>/<drive> with the date's calibration files; returns the drive and painted points."""
    drive, points = root / "2011_09_26_drive_0001_sync", {}
    lines = ["calib_time: 09-Jan-2012 13:57:47", f"R_rect_00: {text(RECTIFY)}"]
    lines += [f"P_rect_{name}: {text(values)}" for name, values in P.items()]
    (drive / "oxts/data").mkdir(parents=True)
    (root / "calib_cam_to_cam.txt").write_text("\n".join(lines))
    for name, motion in (("velo_to_cam", TO_CAMERA), ("imu_to_velo", TO_LIDAR)):
        lines = ["calib_time: 25-May-2012", f"R: {text(motion[:, :3])}", f"T: {text(motion[:, 3])}"]
        (root / f"calib_{name}.txt").write_text("\n".join(lines))
    dates = []
    for i in range(frames):
        stem = f"{i:010d}"
        (drive / f"oxts/data/{stem}.txt").write_text(text(oxts(i)))
        dates.append(f"2011-09-26 13:{i // 600 % 60:02d}:{i // 10 % 60:02d}.{i % 10}25951104")
        if not paint:
            continue
        scan(drive / f"velodyne_points/data/{stem}.bin", i)
        for camera in P:
            point = POINTS[i % 3]
            blob(drive / f"image_{camera}/data/{stem}.png", pixel(i, camera, point))
            points[f"image_{camera}/{stem}.png"] = point
    (drive / "image_02").mkdir(exist_ok=True)
    (drive / "image_02/timestamps.txt").write_text("\n".join(dates) + "\n")
    return drive, points


def tracking(root, *, frames=4, paint=True):
    """training/ with sequence 0001; returns image_02/0001 and the painted points."""
    points = {}
    for name in ("calib", "oxts"):
        (root / name).mkdir()
    lines = [f"P{i}: {text(P[f'0{max(i, 2)}'])}" for i in range(4)]
    lines += [f"R_rect {text(RECTIFY)}", f"Tr_velo_cam {text(TO_CAMERA)}"]
    (root / "calib/0001.txt").write_text("\n".join([*lines, f"Tr_imu_velo {text(TO_LIDAR)}"]))
    (root / "oxts/0001.txt").write_text("".join(text(oxts(i)) + " \n" for i in range(frames)))
    for i in range(frames if paint else 0):
        scan(root / f"velodyne/0001/{i:06d}.bin", i)
        for camera in P:
            point = POINTS[i % 3]
            blob(root / f"image_{camera}/0001/{i:06d}.png", pixel(i, camera, point))
            points[f"image_{camera}/{i:06d}.png"] = point
        blob(root / f"sky_03/0001/{i:06d}.png", np.array([40.0, 5.0]))
    return root / "image_02/0001", points


BOTH = pytest.mark.parametrize("write", [raw, tracking])


@BOTH
def test_points_are_seen_where_they_were_painted(tmp_path, write):
    folder, points = write(tmp_path)
    scene = open_scene(folder, protocol(hold=4, hold_first=3, hold_unit="time"))
    assert worst_error(scene, points) < 0.1
    assert (scene.units, scene.up.tolist()) == ("metres", [0, 0, 1])
    assert [tenths(view) for view in scene.test_views] == [3, 3]
    assert [view.sensor for view in scene.test_views] == ["image_02", "image_03"]
    found = scene.points.positions + scene.shift - torch.from_numpy(np.tile(POINTS, (4, 1)))
    assert found.abs().max() < 1e-5
    assert {path.suffix for path in scene.sources} == {".bin", ".png"}


@BOTH
def test_each_view_has_its_sweep_in_the_scene_frame(tmp_path, write):
    """Float32 of coordinates below 16 metres, in the file and again in the scene's frame."""
    folder, _ = write(tmp_path)
    for rules in ({}, {"clips": ((folder.name, 1, -1),)}):
        scene = open_scene(folder, protocol(**rules))
        for view in scene.views:
            i = int(view.name[-8:-4])
            found = sweep(view)
            assert found.time == view.time
            assert tenths(view) == i - (1 if rules else 0)
            want = torch.from_numpy(POINTS) - scene.shift
            assert (found.positions - want).abs().max() < 16 * 2**-23
            place = (imu(i) @ np.linalg.inv(full(TO_LIDAR)))[:3, 3]
            # the devkit's Mercator is a difference of numbers of 1e7 metres
            assert (found.origin - torch.from_numpy(place) + scene.shift).abs().max() < 1e-7
            beside = (imu((i + 1) % 4) @ np.linalg.inv(full(TO_LIDAR)))[:3, 3]
            # control: the car of another moment
            assert (found.origin - torch.from_numpy(beside) + scene.shift).abs().max() > 0.01


@BOTH
def test_a_sweep_has_its_frames_time_whatever_the_scanners_clock_says(tmp_path, write):
    folder, _ = write(tmp_path)
    if write is raw:
        late = [f"2011-09-26 13:00:00.{i}55951104\n" for i in range(4)]  # 30 ms after the photos
        (folder / "velodyne_points/timestamps.txt").write_text("".join(late))
    views = open_scene(folder, protocol()).views
    assert [view.sweep_time for view in views] == [view.time for view in views]
    assert {tenths(view) for view in views} == {0, 1, 2, 3}


@BOTH
def test_views_of_a_moment_without_a_sweep_have_none(tmp_path, write):
    folder, _ = write(tmp_path)
    path = sorted(tmp_path.rglob("*.bin"))[2]
    scene = open_scene(folder, protocol())
    path.unlink()
    gone = next(view for view in scene.views if tenths(view) == 2)
    with pytest.raises(DataError, match=rf"{path.name}: LiDAR sweep is missing"):
        sweep(gone)
    views = open_scene(folder, protocol()).views
    assert {tenths(view) for view in views if view.load_sweep is None} == {2}


@BOTH
def test_views_are_sent_to_other_processes(tmp_path, write):
    folder, _ = write(tmp_path)
    for view in open_scene(folder, protocol()).views:
        sent = pickle.loads(pickle.dumps(view))
        assert torch.equal(sweep(sent).positions, sweep(view).positions)
        assert torch.equal(sent.load(), view.load())


def test_sky_of_tracking(tmp_path):
    folder, _ = tracking(tmp_path)
    views = {view.name: view for view in open_scene(folder, protocol()).views}
    assert views["image_02/000001.png"].load_sky is None
    seen = sky(views["image_03/000001.png"])
    assert (bool(seen[5, 40]), bool(seen[60, 40])) == (True, False)


def test_faults_of_raw(tmp_path):
    folder, _ = raw(tmp_path)
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        without(tmp_path / name, folder, rf"{name}: no such file")
    without(folder / "oxts/data/0000000002.txt", folder, r"0000000002\.txt: no such file")
    without(folder / "image_03/data/0000000001.png", folder, r"0000000001\.png: photo is missing")
    path = folder / "image_02/timestamps.txt"
    without(path, folder, r"timestamps\.txt: no such file")
    path.write_text(path.read_text() + "2011-09-26 13:02:44.3\n")
    refused(folder, "has 5 dates, but there are 4 photos")


def test_faults_of_tracking(tmp_path):
    folder, _ = tracking(tmp_path)
    without(tmp_path / "oxts/0001.txt", folder, r"oxts/0001\.txt: no such file")
    calib = tmp_path / "calib/0001.txt"
    whole = calib.read_text()
    calib.write_text(whole.replace("Tr_velo_cam", "Tr"))
    refused(folder, r"0001\.txt: has no Tr_velo_cam or Tr_velo_to_cam")
    calib.write_text(whole.replace("R_rect ", "R_rect 1 "))
    refused(folder, "R_rect has 10 numbers, expected 9")
    calib.write_text(whole)
    path = tmp_path / "velodyne/0001/000002.bin"
    path.write_bytes(b"12345")
    refused(folder, r"000002\.bin: has 5 bytes, expected a multiple of 16")
    path.unlink()
    assert open_scene(folder, protocol()).facts["sweeps"] == "3 of 4 frames"
    blob(tmp_path / "image_03/0001/000009.png", np.array([3.0, 3.0]))
    left = open_scene(folder, protocol()).left_out
    assert left == (("image_03/000009.png", "no photo of camera 02"),)
    blob(tmp_path / "image_02/0001/000009.png", np.array([3.0, 3.0]))
    refused(folder, r"oxts/0001\.txt: has 4 lines, expected one of 30 numbers for each of 5 photos")


@pytest.mark.parametrize(
    ("frames", "seconds"), [(200, 6), pytest.param(2500, 15, marks=pytest.mark.slow)]
)
@BOTH
def test_many_views_open_within_bounds(tmp_path, write, frames, seconds):
    folder, _ = write(tmp_path, frames=frames, paint=False)
    blob(tmp_path / "one.png", np.array([5.0, 5.0]))
    for camera in P:
        if write is raw:
            names = [folder / f"image_{camera}/data/{i:010d}.png" for i in range(frames)]
        else:
            names = [tmp_path / f"image_{camera}/0001/{i:06d}.png" for i in range(frames)]
        hard_links(tmp_path / "one.png", names)
    opens_in_bounds(folder, 2 * frames, seconds=seconds)
