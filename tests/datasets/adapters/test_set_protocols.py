"""The protocol of each set does to a fixture of that set what its paper says."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from helpers.adapter_checks import fixtures, tenths
from helpers.posed_scenes import blob
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene


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
    fixtures("adapters").mega_nerf(tmp_path)
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
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    fixtures("adapters").levir_nvs(tmp_path, views=21)
    scene = open_scene(tmp_path, load_protocol("levir_nvs_3"))
    assert [view.name for view in scene.train_views] == ["000.png", "010.png", "020.png"]
    assert len(scene.test) == 18
    assert scene.facts["points"].endswith(" triangulated from 3 training views")


@pytest.mark.parametrize("layout", ["colmap", "nerfstudio"])
def test_3das_has_seven_training_views(tmp_path, monkeypatch, layout):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path))
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
        fixtures("adapters").nerfstudio(folder, distorted=False, views=13)
    scene = open_scene("3das/port_2", load_protocol("3das_7"))
    assert (scene.facts["adapter"], scene.train) == (layout, (0, 2, 4, 6, 8, 10, 12))
    assert scene.test == (1, 3, 5, 7, 9, 11)
    assert scene.facts["points"].endswith(" triangulated from 7 training views")


@pytest.mark.parametrize(("count", "train"), [(3, "048"), (5, "02468"), (9, "012345678")])
def test_aerial_sparse_keeps_its_tests(tmp_path, monkeypatch, count, train):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
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
    ("name", "fixture", "frames", "clip", "moments", "size"),
    [
        ("waymo_pvg", "pvg", 9, None, [3, 7], (96, 72)),
        ("waymo_omnire", "drivestudio", 25, (3, -1), [10, 20], (48, 36)),
    ],
)
def test_waymo(tmp_path, name, fixture, frames, clip, moments, size):
    rules = load_protocol(name)
    assert rules.sensors == ("front", "front_left", "front_right")
    getattr(fixtures("waymo"), fixture)(tmp_path, frames=frames)
    # the fixture has two cameras
    rules = replace(rules, sensors=rules.sensors[:2], undistort="keep")
    if clip:
        rules = replace(rules, clips=((tmp_path.name, *clip),))
    scene = open_scene(tmp_path, rules)
    assert sorted({tenths(view) for view in scene.test_views}) == moments  # from the clip's start
    assert len(scene.test) == 2 * len(moments)
    assert size in sizes(scene)
    if clip:
        assert len(scene.views) == 2 * 22
        assert "images/003_0.jpg" in [view.name for view in scene.views]
        assert ("images/002_0.jpg", f"protocol {name} uses moments 3 to the end") in scene.left_out
        assert scene.facts["clip"] == "3 to 24"
        assert len(scene.points) == 3 * 22  # the sweeps of the clip alone


def test_kitti(tmp_path):
    """PVG's loader holds out index i of the clip where (i + 1) % 4 == 0."""
    folder, _ = fixtures("kitti").tracking(tmp_path, frames=14)
    rules = load_protocol("kitti_pvg")
    assert rules.clips == (("0001", 380, 431), ("0002", 140, 224), ("0006", 65, 120))
    with pytest.raises(DataError, match="14 moments, but protocol kitti_pvg uses 380 to 431"):
        open_scene(folder, rules)
    scene = open_scene(folder, replace(rules, clips=(("0001", 2, 11),)))
    assert held(scene) == [f"image_{c}/0000{i:02d}.png" for c in ("02", "03") for i in (5, 9)]
    assert len(scene.views) == 20
    other = open_scene(folder, replace(rules, clips=(("0002", 380, 431),)))
    assert len(other.views) == 28  # no clip of this sequence: whole


@pytest.mark.parametrize(
    ("name", "fixture", "views"),
    [
        ("waymo_pvg_reconstruction", "pvg", 8),
        ("waymo_omnire_reconstruction", "drivestudio", 8),
        ("kitti_pvg_reconstruction", "tracking", 4),
    ],
)
def test_reconstruction_scores_what_was_trained_on(tmp_path, name, fixture, views):
    rules = load_protocol(name)
    folder = tmp_path
    if fixture == "tracking":
        folder, _ = fixtures("kitti").tracking(tmp_path)
        rules = replace(rules, clips=(("0001", 1, 2),))
    else:
        getattr(fixtures("waymo"), fixture)(tmp_path)
        rules = replace(rules, sensors=rules.sensors[:2], undistort="keep")
    scene = open_scene(folder, rules)
    assert scene.train == scene.test == tuple(range(views))
    views = load_protocol(name.removesuffix("_reconstruction"))
    same = replace(views, name="", source="", scored="training", hold=0, hold_first=0)
    assert replace(same, hold_unit="view") == replace(load_protocol(name), name="", source="")


def test_nerfstudio(tmp_path):
    fixtures("adapters").nerfstudio(tmp_path)
    scene = open_scene(tmp_path, load_protocol("nerfstudio"))
    assert held(scene) == ["images/0.png"]
