import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from helpers.adapter_checks import (
    hard_links,
    moving,
    opens_in_bounds,
    protocol,
    refused,
    sky,
    sweep,
    tenths,
    without,
)
from helpers.posed_scenes import POINTS, SIZE, blob, opengl_to_world, worst_error
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene

F, C = (80.0, 84.0), (50.0, 34.0)
K1, K2, P1, P2, K3 = -0.1, 0.02, 0.01, -0.01, 0.003
FAR = np.array([2.1e4, -3e4, 40.0])
"""Waymo's worlds are far from their origin."""
ROOF, SIDE = (1.43, 0.0, 2.184), (3.2, 1.0, 1.0)
"""Where two LiDARs are on the vehicle."""


def mount(camera):
    """4 x 4 camera to vehicle, both with x forward, y left, z up."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_euler("zyx", [4 * camera, 2, -1], degrees=True).as_matrix()
    motion[:3, 3] = [1.5, 0.05 * camera, 2.1]
    return motion


def vehicle(i):
    """4 x 4 vehicle to world, so that camera 0 looks at the points."""
    opengl = opengl_to_world(i)
    waymo = np.eye(4)
    waymo[:3] = np.stack([-opengl[:3, 2], -opengl[:3, 0], opengl[:3, 1], opengl[:3, 3] + FAR], 1)
    return waymo @ np.linalg.inv(mount(0))


def pixel(i, camera, point, bend):
    """Waymo's own model: x forward is depth, u = -y / x and v = -z / x, bent by k1 k2 p1 p2 k3."""
    x, y, z, _ = np.linalg.inv(vehicle(i) @ mount(camera)) @ [*(point + FAR), 1.0]
    u, v = -y / x, -z / x
    if bend:
        r = u * u + v * v
        d = 1 + K1 * r + K2 * r**2 + K3 * r**3
        u, v = (
            u * d + 2 * P1 * u * v + P2 * (r + 2 * u * u),
            v * d + P1 * (r + 2 * v * v) + 2 * P2 * u * v,
        )
    return np.array([u, v]) * F + C


def write_sky(path):
    mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    mask[:20] = 255
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask).save(path)


def write_moving(folder, name, *, human=(30, 50), vehicle=(40, 90)):
    """Rectangles of drivestudio: columns 30 to 50 a person, 40 to 90 a vehicle, rows 20 to 60."""
    spans = {"human": [human], "vehicle": [vehicle], "all": [human, vehicle]}
    for kind, columns in spans.items():
        mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
        for start, end in columns:
            mask[20:60, start:end] = 255
        (folder / kind).mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).save(folder / kind / name)


def drivestudio(folder, *, frames=4, paint=True):
    points = {}
    for name in ("ego_pose", "extrinsics", "intrinsics", "lidar"):
        (folder / name).mkdir()
    for camera in (0, 1):
        bend = [K1, K2, P1, P2, K3] if camera == 0 else [0] * 5
        np.savetxt(folder / f"intrinsics/{camera}.txt", [*F, *C, *bend])
        np.savetxt(folder / f"extrinsics/{camera}.txt", mount(camera))
    for i in range(frames):
        np.savetxt(folder / f"ego_pose/{i:03d}.txt", vehicle(i))
        if not paint:
            continue
        for camera in (0, 1):
            name, point = f"images/{i:03d}_{camera}.jpg", POINTS[i % 3]
            blob(folder / name, pixel(i, camera, point, camera == 0))
            points[name] = point + FAR
        rows = np.zeros((3, 14), np.float32)
        inside = np.c_[POINTS + FAR, np.ones(3)] @ np.linalg.inv(vehicle(i)).T
        rows[:, :3] = [ROOF, ROOF, SIDE]
        rows[:, 3:6] = inside[:, :3]
        rows.tofile(folder / f"lidar/{i:03d}.bin")
        write_sky(folder / f"sky_masks/{i:03d}_1.png")
        for camera in (0, 1):
            write_moving(folder / "dynamic_masks", f"{i:03d}_{camera}.png")
    return points


def pvg(folder, *, frames=4, paint=True):
    """As the converter writes: KITTI's axes in the calibration, six-digit numbers."""
    points = {}
    axes = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    for name in ("calib", "pose", "velodyne"):
        (folder / name).mkdir()
    for i in range(frames):
        name = f"{145000 + i:07d}"
        lines = []
        for camera in range(5):
            P = [F[0], 0, C[0], 0, 0, F[1], C[1], 0, 0, 0, 1, 0]
            lines.append(f"P{camera}: " + " ".join(f"{x:e}" for x in P))
        lines.append("R0_rect: " + " ".join(f"{x:e}" for x in np.eye(3).ravel()))
        for camera in range(5):
            Tr = (axes @ np.linalg.inv(mount(camera)))[:3].ravel()
            lines.append(f"Tr_velo_to_cam_{camera}: " + " ".join(f"{x:e}" for x in Tr))
        (folder / f"calib/{name}.txt").write_text("\n".join(lines) + "\n")
        np.savetxt(folder / f"pose/{name}.txt", vehicle(i))
        if not paint:
            continue
        for camera in (0, 1):
            file, point = f"image_{camera}/{name}.png", POINTS[i % 3]
            blob(folder / file, pixel(i, camera, point, bend=False))
            points[file] = point + FAR
        rows = np.zeros((3, 6), np.float32)
        rows[:, :3] = (np.c_[POINTS + FAR, np.ones(3)] @ np.linalg.inv(vehicle(i)).T)[:, :3]
        rows.tofile(folder / f"velodyne/{name}.bin")
        write_sky(folder / f"sky_1/{name}.png")
    return points


BOTH = pytest.mark.parametrize("write", [drivestudio, pvg])


@BOTH
def test_points_are_seen_where_they_were_painted(tmp_path, write):
    points = write(tmp_path)
    scene = open_scene(tmp_path, protocol(hold=2, hold_first=1, hold_unit="time"))
    assert worst_error(scene, points) < 0.1
    assert (scene.units, scene.up.tolist()) == ("metres", [0, 0, 1])
    assert {view.sensor for view in scene.views} == {"front", "front_left"}
    assert {tenths(view) for view in scene.test_views} == {1, 3}
    assert len(scene.test) == len(scene.train) == 4


@BOTH
def test_lidar_sky_and_chosen_cameras(tmp_path, write):
    write(tmp_path)
    rules = {"hold": 2, "hold_unit": "time", "sensors": ("front_left",)}
    scene = open_scene(tmp_path, protocol(**rules))
    assert len(scene.views) == 4
    assert len(scene.left_out) == 4
    # float32 coordinates of metres around the vehicle
    found = scene.points.positions + scene.shift - torch.from_numpy(np.tile(POINTS + FAR, (4, 1)))
    assert found.abs().max() < 1e-5
    assert scene.facts["sweeps"] == "4 of 4 frames"
    assert len(open_scene(tmp_path, protocol(drop_test_points=True, **rules)).points) == 6
    seen = sky(scene.views[0])
    assert (seen[:20].all(), seen[20:].any()) == (True, False)
    half = sky(open_scene(tmp_path, protocol(factor=2.0, **rules)).views[0])
    assert (half[:10].all(), half[10:].any()) == (True, False)
    assert scene.views[0].load_mask is None
    assert open_scene(tmp_path, protocol()).views[0].load_sky is None  # has no file
    refused(tmp_path, "has no camera 'back', .* it has 'front', 'front_left'", sensors=("back",))


@BOTH
def test_each_view_has_its_sweep_in_the_scene_frame(tmp_path, write):
    """Float32 of coordinates below 4 metres, in the file and again in the scene's frame."""
    write(tmp_path)
    for rules in ({}, {"clips": ((tmp_path.name, 1, -1),)}):
        scene = open_scene(tmp_path, protocol(**rules))
        assert scene.shift.abs().max() > 1e4
        for view in scene.views:
            found = sweep(view)
            i = int(Path(view.name).stem.split("_")[0]) % 1000
            assert found.time == view.time
            assert tenths(view) == i - (1 if rules else 0)
            want = torch.from_numpy(POINTS + FAR) - scene.shift
            assert (found.positions - want).abs().max() < 4 * 2**-23
            origin = torch.from_numpy(vehicle(i)[:3, :3] @ ROOF + vehicle(i)[:3, 3]) - scene.shift
            # of 3e4 metres in float64, after a mount in float32
            assert (found.origin - origin).abs().max() < 4 * 2**-23
            other = torch.from_numpy(vehicle((i + 1) % 4)[:3] @ [*ROOF, 1.0]) - scene.shift
            assert (found.origin - other).abs().max() > 1  # control: the vehicle of another moment


@BOTH
def test_views_of_a_moment_without_a_sweep_have_none(tmp_path, write):
    write(tmp_path)
    bins = sorted(tmp_path.rglob("*.bin"))
    scene = open_scene(tmp_path, protocol())
    bins[1].unlink()
    gone = next(view for view in scene.views if tenths(view) == 1)
    with pytest.raises(DataError, match=rf"{bins[1].name}: LiDAR sweep is missing"):
        sweep(gone)
    views = open_scene(tmp_path, protocol()).views
    assert {tenths(view) for view in views if view.load_sweep is None} == {1}
    bins[0].write_bytes(b"123")
    with pytest.raises(DataError, match=rf"{bins[0].name}: has 3 bytes, expected a multiple of"):
        sweep(scene.views[0])


@BOTH
def test_views_are_sent_to_other_processes(tmp_path, write):
    write(tmp_path)
    for view in open_scene(tmp_path, protocol()).views:
        sent = pickle.loads(pickle.dumps(view))
        assert torch.equal(sweep(sent).positions, sweep(view).positions)
        assert torch.equal(sent.load(), view.load())
        if view.load_moving:
            assert moving(sent).keys() == moving(view).keys()


def test_what_moves(tmp_path):
    drivestudio(tmp_path)
    rules = {"hold": 0, "sensors": ("front_left",)}  # a pinhole: pixels stay where they are
    view = open_scene(tmp_path, protocol(**rules)).views[0]
    whole = moving(view)
    assert whole.keys() == {"people", "vehicles"}
    assert whole["people"].nonzero().amin(0).tolist() == [20, 30]
    assert whole["people"].nonzero().amax(0).tolist() == [59, 49]
    assert int(whole["vehicles"].sum()) == 40 * 50
    half = moving(open_scene(tmp_path, protocol(factor=2.0, **rules)).views[0])
    assert half["vehicles"].nonzero().amin(0).tolist() == [10, 20]
    assert int(half["vehicles"].sum()) == 20 * 25
    for i in range(4):  # segments go before rectangles
        for camera in (0, 1):
            write_moving(tmp_path / "fine_dynamic_masks", f"{i:03d}_{camera}.png", vehicle=(60, 70))
    fine = moving(open_scene(tmp_path, protocol(**rules)).views[0])
    assert int(fine["vehicles"].sum()) == 40 * 10
    assert torch.equal(fine["people"], whole["people"])


def test_masks_of_bent_photos_are_bent_back(tmp_path):
    """The blob's own pixels as a mask land on the blob of the undistorted photo."""
    drivestudio(tmp_path)
    name = "002_0.png"
    spot = np.array(Image.open(tmp_path / f"images/{name[:-4]}.jpg").convert("L")) > 100
    Image.fromarray(255 * spot.astype(np.uint8)).save(tmp_path / "dynamic_masks/human" / name)
    views = {v.name: v for v in open_scene(tmp_path, protocol(hold=0)).views}
    view = views[f"images/{name[:-4]}.jpg"]
    bright = view.load()[..., 0] > 100 / 255
    people = moving(view)["people"]
    assert int(bright.sum()) > 8
    # an outline may move by the rounding of a bilinear sample
    assert int((people ^ bright).sum()) <= 0.35 * int(bright.sum())
    assert not (people & ~spread(bright)).any()


def spread(mask):
    """The mask and its neighbours."""
    grown = torch.nn.functional.max_pool2d(mask[None].float(), 3, stride=1, padding=1)
    return grown[0] > 0


def test_drivestudio_faults(tmp_path):
    drivestudio(tmp_path)
    mask = tmp_path / "dynamic_masks/human/000_1.png"
    kept = mask.read_bytes()
    mask.unlink()
    refused(
        tmp_path, r"human/000_1\.png: mask of what moves is missing; export it again, or remove"
    )
    mask.write_bytes(b"rubbish")
    with pytest.raises(DataError, match=r"human/000_1\.png: not a readable image"):
        moving(open_scene(tmp_path, protocol()).views[1])
    mask.write_bytes(kept)
    without(tmp_path / "intrinsics/0.txt", tmp_path, r"intrinsics/0\.txt: no such file")
    without(tmp_path / "extrinsics/1.txt", tmp_path, r"extrinsics/1\.txt: no such file")
    without(tmp_path / "images/002_1.jpg", tmp_path, "images/002_1: photo is missing with any of")
    (tmp_path / "ego_pose/001.txt").write_text("1 2 3")
    refused(tmp_path, r"ego_pose/001\.txt: has 3 words, expected 16 finite numbers")
    np.savetxt(tmp_path / "ego_pose/001.txt", 2 * np.eye(4))
    refused(tmp_path, r"001\.txt: the pose is no rotation")
    np.savetxt(tmp_path / "ego_pose/001.txt", vehicle(1))
    (tmp_path / "lidar/002.bin").write_bytes(b"1234")
    refused(tmp_path, r"lidar/002\.bin: has 4 bytes, expected a multiple of 56")
    (tmp_path / "lidar/002.bin").unlink()
    blob(tmp_path / "images/009_0.jpg", np.array([3.0, 3.0]))
    scene = open_scene(tmp_path, protocol())
    assert scene.facts["sweeps"] == "3 of 4 frames"
    assert scene.left_out == (("images/009_0.jpg", "no pose or no camera"),)
    Image.new("L", (7, 5)).save(tmp_path / "dynamic_masks/vehicle/000_1.png")
    with pytest.raises(DataError, match=r"vehicle/000_1\.png: mask is 7 x 5, its photo is 96 x 72"):
        moving(open_scene(tmp_path, protocol()).views[1])
    Image.new("L", (5, 5)).save(tmp_path / "sky_masks/000_1.png")
    with pytest.raises(DataError, match="mask is 5 x 5, its photo is 96 x 72"):
        sky(open_scene(tmp_path, protocol()).views[1])


def test_pvg_faults(tmp_path):
    pvg(tmp_path)
    calib = tmp_path / "calib/0145001.txt"
    whole = calib.read_text()
    calib.write_text(whole.replace("Tr_velo_to_cam_1", "Tr"))
    refused(tmp_path, r"0145001\.txt: has no Tr_velo_to_cam_1")
    calib.write_text(whole.replace("P1: ", "P1: 1 "))
    refused(tmp_path, "P1 has 13 numbers, expected 12")
    calib.write_text(whole)
    without(tmp_path / "pose/0145002.txt", tmp_path, r"pose/0145002\.txt: no such file")
    without(tmp_path / "image_1/0145000.png", tmp_path, "image_1/0145000: photo is missing")
    blob(tmp_path / "image_0/9.png", np.array([3.0, 3.0]))
    assert open_scene(tmp_path, protocol()).left_out[0][0] == "image_0/9.png"


@pytest.mark.parametrize(
    ("write", "part", "name"), [(drivestudio, "ego_pose", "00"), (pvg, "calib", "014500")]
)
def test_a_gap_between_frames_is_refused(tmp_path, write, part, name):
    write(tmp_path)
    (tmp_path / part / f"{name}1.txt").unlink()
    refused(tmp_path, rf"{part}/{name}1\.txt: missing, but {name}2 comes after it; export it again")
    (tmp_path / part / "odd.txt").write_text("")
    refused(tmp_path, r"odd\.txt: expected a frame's number for a name|1\.txt: missing, but")
    for path in (tmp_path / part).glob("*.txt"):
        path.unlink()
    refused(tmp_path, "has no frame with a camera")


@pytest.mark.parametrize(
    ("frames", "seconds"), [(200, 6), pytest.param(2500, 15, marks=pytest.mark.slow)]
)
@BOTH
def test_many_views_open_within_bounds(tmp_path, write, frames, seconds):
    write(tmp_path, frames=frames, paint=False)
    blob(tmp_path / "one.png", np.array([5.0, 5.0]))
    pairs = [(i, c) for i in range(frames) for c in (0, 1)]
    if write is drivestudio:
        names = [f"images/{i:03d}_{c}.png" for i, c in pairs]
    else:
        names = [f"image_{c}/{145000 + i:07d}.png" for i, c in pairs]
    hard_links(tmp_path / "one.png", [tmp_path / name for name in names])
    opens_in_bounds(tmp_path, 2 * frames, seconds=seconds)
