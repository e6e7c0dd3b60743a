"""The protocol of each set does to a fixture of that set what its paper says."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from helpers.door_checks import fixtures, tenths
from helpers.posed_scenes import blob
from splatbench.datasets.opening import open_scene
from splatbench.metrics.protocol_files import load_protocol
from splatbench.reference.scene import Scene


def sizes(scene: Scene) -> set[tuple[int, int]]:
    return {(view.camera.width, view.camera.height) for view in scene.views}


def held(scene: Scene) -> list[str]:
    return [view.name for view in scene.test_views]


def test_llff(tmp_path):
    fixtures("llff").llff(tmp_path, views=10)
    (tmp_path / "images_4").mkdir()
    for i in range(10):
        blob(tmp_path / f"images_4/{i}.png", np.array([9.0, 9.0]), size=(24, 18))
    scene = open_scene(tmp_path, load_protocol("llff"))
    assert (sizes(scene), held(scene)) == ({(24, 18)}, ["0.png", "8.png"])


@pytest.mark.parametrize(
    ("name", "folder", "factor"),
    [
        ("mipnerf360_outdoor", "images_4", 4),
        ("mipnerf360_indoor", "images_2", 2),
        ("tanks_and_temples", "images", 1),
    ],
)
def test_colmap_scenes_with_copies(tmp_path, name, folder, factor):
    made = fixtures("photo_tourism")
    made.write_scene(tmp_path, made.FLIGHT)
    (tmp_path / "photos").rename(tmp_path / "images")
    for i in range(6 if factor > 1 else 0):
        size = (96 // factor, 72 // factor)
        blob(tmp_path / folder / made.view_name(i), np.array([9.0, 9.0]), size=size)
    scene = open_scene(tmp_path, load_protocol(name))
    assert sizes(scene) == {(96 // factor, 72 // factor)}
    assert held(scene) == [made.view_name(0)]
    assert scene.facts["image_folder"] == folder


def test_photo_tourism(tmp_path):
    made = fixtures("photo_tourism")
    made.tourism(tmp_path, ["train", "test", "train"])
    rules = load_protocol("photo_tourism")
    scene = open_scene(tmp_path, rules)
    assert (sizes(scene), held(scene)) == ({(48, 36)}, [made.view_name(1)])
    assert (rules.appearance, rules.region) == ("half", "right_half")


@pytest.mark.parametrize(
    ("name", "region"), [("mega-nerf", "right_half"), ("mega-nerf_gs", "full")]
)
def test_mega_nerf(tmp_path, name, region):
    fixtures("doors").mega_nerf(tmp_path)
    rules = load_protocol(name)
    scene = open_scene(tmp_path, rules)
    assert (sizes(scene), held(scene)) == ({(24, 18)}, ["val/rgbs/000000.jpg"])
    assert rules.region == region


def test_matrix_city(tmp_path):
    fixtures("matrix_city").city(tmp_path)
    rules = load_protocol("matrixcity")
    assert rules.width == 1600
    scene = open_scene(tmp_path, replace(rules, width=80))
    assert (sizes(scene), held(scene)) == ({(80, 60)}, ["test/block_1_test/0002.png"])


def test_levir_nvs_has_three_training_views(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATBENCH_CACHE", str(tmp_path / "cache"))
    fixtures("doors").levir_nvs(tmp_path, views=21)
    scene = open_scene(tmp_path, load_protocol("levir_nvs_3"))
    assert [view.name for view in scene.train_views] == ["000.png", "010.png", "020.png"]
    assert len(scene.test) == 18
    assert scene.facts["points"].endswith(" triangulated from 3 training views")


@pytest.mark.parametrize("layout", ["colmap", "nerfstudio"])
def test_3das_has_seven_training_views(tmp_path, monkeypatch, layout):
    monkeypatch.setenv("SPLATBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("SPLATBENCH_DATA", str(tmp_path))
    folder = tmp_path / "3das" / "port_2"
    if layout == "colmap":  # poses alone
        made = fixtures("photo_tourism")
        made.write_scene(folder, replace(made.FLIGHT, views=13))
        model = pycolmap.Reconstruction(folder / "sparse/0")
        for number in list(model.point3D_ids()):
            model.delete_point3D(number)
        model.write(folder / "sparse/0")
    else:
        folder.mkdir(parents=True)
        fixtures("doors").nerfstudio(folder, distorted=False, views=13)
    scene = open_scene("3das/port_2", load_protocol("3das_7"))
    assert (scene.facts["adapter"], scene.train) == (layout, (0, 2, 4, 6, 8, 10, 12))
    assert scene.test == (1, 3, 5, 7, 9, 11)
    assert scene.facts["points"].endswith(" triangulated from 7 training views")


@pytest.mark.parametrize(("count", "train"), [(3, "048"), (5, "02468"), (9, "012345678")])
def test_aerial_sparse_keeps_its_tests(tmp_path, monkeypatch, count, train):
    monkeypatch.setenv("SPLATBENCH_CACHE", str(tmp_path / "cache"))
    made = fixtures("photo_tourism")
    made.write_scene(tmp_path, replace(made.FLIGHT, views=12))
    model = pycolmap.Reconstruction(tmp_path / "sparse/0")
    for i, image in enumerate(sorted(model.images.values(), key=lambda image: image.name)):
        name = f"test_{i:02d}.png" if i < 3 else f"train_{i - 3:02d}.png"
        (tmp_path / "photos" / image.name).rename(tmp_path / "photos" / name)
        image.name = name
    model.write(tmp_path / "sparse/0")
    scene = open_scene(tmp_path, load_protocol(f"aerial_sparse_{count}"))
    assert held(scene) == ["test_00.png", "test_01.png", "test_02.png"]
    assert [view.name for view in scene.train_views] == [f"train_0{i}.png" for i in train]


@pytest.mark.parametrize(
    ("name", "fixture", "frames", "moments", "size"),
    [
        ("waymo_pvg", "pvg", 9, [3, 7], (96, 72)),
        ("waymo_omnire", "drivestudio", 21, [10, 20], (48, 36)),
    ],
)
def test_waymo(tmp_path, name, fixture, frames, moments, size):
    rules = load_protocol(name)
    assert rules.sensors == ("front", "front_left", "front_right")
    getattr(fixtures("waymo"), fixture)(tmp_path, frames=frames)
    # the fixture has two cameras
    scene = open_scene(tmp_path, replace(rules, sensors=rules.sensors[:2], undistort="keep"))
    assert sorted({tenths(view) for view in scene.test_views}) == moments
    assert len(scene.test) == 2 * len(moments)
    assert size in sizes(scene)


def test_kitti(tmp_path):
    folder, _ = fixtures("kitti").tracking(tmp_path, frames=8)
    scene = open_scene(folder, load_protocol("kitti_pvg"))
    assert sorted({tenths(view) for view in scene.test_views}) == [3, 7]
    assert len(scene.test) == 4


def test_nerfstudio(tmp_path):
    fixtures("doors").nerfstudio(tmp_path)
    scene = open_scene(tmp_path, load_protocol("nerfstudio"))
    assert held(scene) == ["images/0.png"]
