import json
import math

import numpy as np
import pytest

from helpers.adapter_checks import hard_links, opens_in_bounds, protocol, refused, without
from helpers.posed_scenes import POINTS, SIZE, blob, opengl_rays, opengl_to_world, worst_error
from splatproof.datasets.catalogue.opening import open_scene

ANGLE = 1.1
FOCAL = SIZE[0] / (2 * math.tan(ANGLE / 2))
METRES = 100.0
"""The fixture's world in metres is this times the world of the helper's poses."""


def city(folder, *, raw_scale=0.01):
    """Blocks as rendered, train and test, and their split in pose/; returns the painted points."""
    points, listed = {}, {"train": [], "test": []}
    for i, (split, block) in enumerate(
        [("train", "block_1"), ("train", "block_2"), ("test", "block_1_test")]
    ):
        pose, point = opengl_to_world(i), POINTS[i]
        name = f"{split}/{block}/{i:04d}.png"
        blob(folder / name, opengl_rays(pose, point[None])[0] * FOCAL + np.array(SIZE) / 2)
        points[name] = point * METRES
        raw = pose.copy()
        raw[:3, :3] *= raw_scale
        raw[:3, 3] *= METRES
        data = {"camera_angle_x": ANGLE, "frames": [{"frame_index": i, "rot_mat": raw.tolist()}]}
        (folder / split / block / "transforms.json").write_text(json.dumps(data))
        listed[split].append({"file_path": f"../../{name}", "transform_matrix": pose.tolist()})
    for split, frames in listed.items():
        data = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": SIZE[0] / 2, "cy": SIZE[1] / 2}
        data |= {"w": float(SIZE[0]), "h": float(SIZE[1]), "camera_angle_x": ANGLE}
        path = folder / f"pose/block_A/transforms_{split}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(data | {"frames": frames}))
    return points


@pytest.mark.parametrize("part", ["", "pose/block_A"])
def test_points_are_seen_where_they_were_painted(tmp_path, part):
    points = city(tmp_path / "aerial")
    scene = open_scene(tmp_path / "aerial" / part, protocol())
    assert worst_error(scene, points) < 0.1
    assert [view.name for view in scene.test_views] == ["test/block_1_test/0002.png"]
    assert (scene.units, scene.up.tolist()) == ("metres", [0, 0, 1])


def test_a_whole_part_takes_its_split_of_all_blocks(tmp_path):
    points = city(tmp_path)
    (tmp_path / "pose/block_A").rename(tmp_path / "pose/block_all")
    (tmp_path / "train/block_1/transforms.json").unlink()
    assert worst_error(open_scene(tmp_path, protocol()), points) < 0.1


def test_faults_are_named(tmp_path):
    city(tmp_path, raw_scale=0.02)
    refused(tmp_path, "frame 0: the pose is no rotation")
    city(tmp_path)
    without(tmp_path / "train/block_2/0001.png", tmp_path, r"block_2/0001\.png: photo is missing")
    blob(tmp_path / "train/block_1/0009.png", np.array([3.0, 3.0]))
    left = open_scene(tmp_path, protocol()).left_out
    assert left == (("train/block_1/0009.png", "no frame in transforms.json"),)
    split = tmp_path / "pose/block_A"
    without(split / "transforms_test.json", split, r"transforms_test\.json: no such file")
    path = split / "transforms_train.json"
    whole = path.read_text()
    path.write_text(whole.replace("../../train/block_1", "../../../elsewhere"))
    refused(split, "leads out of")
    path.write_text(whole.replace('"fl_x"', '"fl"'))
    refused(split, "fl_x is None")
    path = tmp_path / "train/block_1/transforms.json"
    path.write_text(path.read_text().replace('"frame_index": 0', '"frame_index": "0"'))
    refused(tmp_path, "frame 0 has frame_index '0', expected a value of type int")


@pytest.mark.slow
def test_five_thousand_views(tmp_path):
    city(tmp_path)
    path = tmp_path / "train/block_1/transforms.json"
    data = json.loads(path.read_text())
    data["frames"] = [data["frames"][0] | {"frame_index": i} for i in range(5000)]
    path.write_text(json.dumps(data))
    block = tmp_path / "train/block_1"
    hard_links(block / "0000.png", [block / f"{i:04d}.png" for i in range(1, 5000)])
    opens_in_bounds(tmp_path, 5002)
