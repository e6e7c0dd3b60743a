"""KITTI's boxes: their corners where the devkit projects them, masks of those that move."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path as Outline
from scipy.spatial import ConvexHull

from helpers.adapter_checks import fixtures, moving, protocol, refused
from splatproof.datasets.adapters.kitti_boxes import read_labels, read_tracklets
from splatproof.datasets.boxes import Box, box_outline, covered, in_motion
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.reference.types.camera import project_points

KITTI = fixtures("kitti")
SIZE = (1.6, 1.8, 4.0)
"""Height, width, length, as KITTI has them."""
FRAMES = 6


def rectified(i):
    """World to camera 0 rectified at frame i, by the devkit's chain."""
    lidar = KITTI.full(KITTI.TO_LIDAR) @ np.linalg.inv(KITTI.imu(i))
    return KITTI.full(np.c_[KITTI.RECTIFY, np.zeros(3)]) @ KITTI.full(KITTI.TO_CAMERA) @ lidar


def place(i, ahead=9.0, speed=4.0):
    """A thing that drives on, in camera 0 rectified: the middle of its bottom, and its turn."""
    return np.array([0.4, 1.5, ahead + speed * 0.1 * i]), 0.3 + 0.02 * i


def devkit_corners(position, turn):
    """The tracking devkit's own: x by length, y from 0 up to -height, z by width, turned about y."""
    height, width, length = SIZE
    x = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    y = height * np.array([0, 0, 0, 0, -1, -1, -1, -1])
    z = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    c, s = np.cos(turn), np.sin(turn)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return (about_y @ np.stack([x, y, z])).T + position


def devkit_pixels(camera, position, turn):
    pixels = np.c_[devkit_corners(position, turn), np.ones(8)] @ KITTI.P[camera].T
    return pixels[:, :2] / pixels[:, 2:]


def label(frame, track, kind, position, turn):
    numbers = [*SIZE, *position, turn]
    return f"{frame} {track} {kind} 0 0 -1.5 0 0 10 10 " + " ".join(f"{n:.9f}" for n in numbers)


def tracking(root, lines):
    folder, _ = KITTI.tracking(root, frames=FRAMES)
    (root / "label_02").mkdir()
    (root / "label_02/0001.txt").write_text("\n".join(lines) + "\n")
    return folder


def tracklets(root, *, kind="Car", first=0, count=FRAMES):
    """A tracklet in the LiDAR's frame that drives ahead at 4 m/s."""
    folder, _ = KITTI.raw(root, frames=FRAMES)
    poses = "".join(
        f"<item><tx>{9 + 0.4 * i}</tx><ty>0.3</ty><tz>-1.6</tz><rx>0</rx><ry>0</ry><rz>{0.1}</rz>"
        "<state>2</state></item>"
        for i in range(count)
    )
    height, width, length = SIZE
    (folder / "tracklet_labels.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?><!DOCTYPE boost_serialization>'
        f"<boost_serialization><tracklets><count>1</count><item><objectType>{kind}</objectType>"
        f"<h>{height}</h><w>{width}</w><l>{length}</l><first_frame>{first}</first_frame>"
        f"<poses><count>{count}</count>{poses}</poses><finished>1</finished></item>"
        "</tracklets></boost_serialization>"
    )
    return folder


def matched(found, wanted):
    """Largest distance of a wanted position from the nearest found one."""
    gaps = np.linalg.norm(found[:, None] - wanted[None], axis=2)
    return max(gaps.min(axis=0).max(), gaps.min(axis=1).max())


def test_corners_of_labels_are_seen_where_the_devkit_projects_them(tmp_path):
    lines = [label(i, 0, "Car", *place(i)) for i in range(FRAMES)]
    folder = tracking(tmp_path, lines)
    scene = open_scene(folder, protocol(hold=0))
    to_scene = [np.linalg.inv(rectified(i)) for i in range(FRAMES)]
    boxes = read_labels(tmp_path / "label_02/0001.txt", to_scene)
    assert [box.frame for box in boxes] == list(range(FRAMES))
    worst = 0.0
    for view in scene.views:
        box = boxes[int(view.name[-10:-4])]
        corners = torch.from_numpy(box.corners) - scene.shift
        pixels, _ = project_points(view.camera, corners)
        wanted = devkit_pixels(view.sensor[-2:], *place(box.frame))
        worst = max(worst, matched(pixels.numpy(), wanted))
        assert box.pose[2, 2] > 0.99  # up is up
    assert worst < 0.1
    length, width, height = boxes[0].size
    wrong = replace(boxes[0], size=(width, length, height))
    pixels, _ = project_points(scene.views[0].camera, torch.from_numpy(wrong.corners) - scene.shift)
    assert matched(pixels.numpy(), devkit_pixels("02", *place(0))) > 0.1  # the check can fail


def test_corners_of_tracklets_are_seen_where_the_devkit_projects_them(tmp_path):
    folder = tracklets(tmp_path)
    scene = open_scene(folder, protocol(hold=0))
    to_scene = [KITTI.imu(i) @ np.linalg.inv(KITTI.full(KITTI.TO_LIDAR)) for i in range(FRAMES)]
    boxes = read_tracklets(folder / "tracklet_labels.xml", to_scene)
    height, width, length = SIZE
    worst = 0.0
    for view in scene.views:
        i = int(view.name[-14:-4])
        c, s = np.cos(0.1), np.sin(0.1)
        x = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
        y = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
        z = height * np.array([0, 0, 0, 0, 1, 1, 1, 1]) - 1.6
        lidar = np.stack([c * x - s * y + 9 + 0.4 * i, s * x + c * y + 0.3, z, np.ones(8)], axis=1)
        camera = KITTI.full(np.c_[KITTI.RECTIFY, np.zeros(3)]) @ KITTI.full(KITTI.TO_CAMERA)
        wanted = lidar @ camera.T @ KITTI.P[view.sensor[-2:]].T
        pixels, _ = project_points(view.camera, torch.from_numpy(boxes[i].corners) - scene.shift)
        worst = max(worst, matched(pixels.numpy(), wanted[:, :2] / wanted[:, 2:]))
    assert worst < 0.1


def test_masks_cover_what_moves_and_not_what_is_parked(tmp_path):
    parked = []
    for i in range(FRAMES):  # stands still in the world while the car drives by
        local = rectified(i) @ np.linalg.inv(rectified(0)) @ [-2.0, 1.5, 14.0, 1.0]
        parked.append(label(i, 1, "Car", local[:3], 0.0))
    walker = [label(i, 2, "Pedestrian", [2.0 - 0.15 * i, 1.5, 12.0], 0.0) for i in range(FRAMES)]
    other = [label(i, -1, "DontCare", [-1000, -1000, -1000], -10) for i in range(FRAMES)]
    car = [label(i, 0, "Car", *place(i)) for i in range(FRAMES)]
    folder = tracking(tmp_path, [*car, *parked, *walker, *other])
    scene = open_scene(folder, protocol(hold=0))
    for view in scene.views:
        i, masks = int(view.name[-10:-4]), moving(view)
        assert masks["people"].any()
        height, width = masks["vehicles"].shape
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        corners = devkit_pixels(view.sensor[-2:], *place(i))
        hull = Outline(corners[ConvexHull(corners).vertices])
        inside = hull.contains_points(np.stack([x.ravel(), y.ravel()], 1)).reshape(height, width)
        # the parked car lies elsewhere in the photo, so it would be seen here
        assert (masks["vehicles"].numpy() ^ inside).sum() <= 4
        assert inside.sum() > 300


def box(frame, position, track="a"):
    pose = np.eye(4)
    pose[:3, 3] = position
    return Box(track=track, kind="vehicles", frame=frame, pose=pose, size=(4.0, 2.0, 1.5))


@given(speed=st.floats(0, 20), jitter=st.floats(0, 0.15), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_speed_is_told_through_jitter(speed, jitter, seed):
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-jitter, jitter, (30, 3)) / np.sqrt(3)
    boxes = [box(i, [speed * 0.1 * i, 0, 0] + noise[i]) for i in range(30)]
    found = in_motion(boxes, [0.1 * i for i in range(30)])
    # over at least half a second, jitter is worth 2 jitter / 0.5 s
    if speed > 1 + 4 * jitter + 1e-6:
        assert len(found) == 30
    if speed < 1 - 4 * jitter - 1e-6:
        assert not found


def test_a_track_of_one_moment_stands_and_tracks_are_told_apart():
    assert in_motion([box(3, [0, 0, 0])], [0.1 * i for i in range(5)]) == []
    far = [box(0, [0, 0, 0], "a"), box(1, [9, 0, 0], "b")]
    assert in_motion(far, [0.0, 0.1]) == []


def test_a_box_beside_the_camera_is_cut_off_and_one_behind_it_is_not_seen():
    K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # looks along the box's x
    beside = covered([box(0, [0.5, 2.5, 0])], K, pose, (64, 48))
    assert beside[:, :6].any()
    assert not beside[:, 32:].any()
    assert not covered([box(0, [-9, 0, 0])], K, pose, (64, 48)).any()
    assert covered([box(0, [0, 0, 0])], K, pose, (64, 48)).all()  # from inside
    outline = box_outline(box(0, [9, 0, 0]), K, pose)
    assert np.allclose(sorted(set(outline[:, 0].round(6))), [32 - 50 / 7, 32 + 50 / 7])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("0 1 Car 0 0", "line 1 is no label of a frame from 0 to 5"),
        (label(0, 1, "Spaceship", [0, 0, 9], 0), "line 1 is no label"),
        (label(6, 1, "Car", [0, 0, 9], 0), "line 1 is no label"),
        (label(-1, 1, "Car", [0, 0, 9], 0), "line 1 is no label"),
        (label(0, 1, "Car", [0, np.nan, 9], 0), "line 1 is no label"),
        (label(0, 1, "Car", [0, 0, 9], 0).replace("Car", "Car x y"), "line 1 is no label"),
    ],
)
def test_faults_of_labels(tmp_path, line, said):
    folder = tracking(tmp_path, [line])
    refused(folder, rf"label_02/0001\.txt: {said}")


def test_faults_of_tracklets(tmp_path):
    folder = tracklets(tmp_path, first=2)
    assert not moving(open_scene(folder, protocol()).views[0])["vehicles"].any()
    assert moving(open_scene(folder, protocol()).views[3])["vehicles"].any()
    path = folder / "tracklet_labels.xml"
    whole = path.read_text()
    for old, new, said in (
        ("</boost_serialization>", "", "not an XML file"),
        ("<objectType>Car", "<objectType>Tree", "tracklet 0 is not one of KITTI's"),
        ("<tx>9.0</tx>", "<tx>nan</tx>", "tracklet 0 is not one of KITTI's"),
        ("<first_frame>2", "<first_frame>-2", "tracklet 0 is not one of KITTI's"),
    ):
        assert old in whole
        path.write_text(whole.replace(old, new))
        refused(folder, rf"tracklet_labels\.xml: {said}")
    path.unlink()
    assert open_scene(folder, protocol()).views[0].load_moving is None
