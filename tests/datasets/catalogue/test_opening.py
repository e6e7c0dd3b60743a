import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image

from helpers.adapter_checks import refused, valid
from helpers.colmap_scenes import Flight, reconstruction, view_name, write_scene
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.scene_file import SceneFile, write_scene_file
from splatproof.datasets.splits import split_hash
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

FLIGHT = Flight(views=6)


def protocol(**rules) -> Protocol:
    return Protocol(name="test", source="test", **rules)


def same(a: Scene, b: Scene) -> None:
    assert [view.name for view in a.views] == [view.name for view in b.views]
    for first, second in zip(a.views, b.views, strict=True):
        assert torch.equal(first.camera.K, second.camera.K)
        assert torch.equal(first.camera.world_to_camera, second.camera.world_to_camera)
    assert torch.equal(a.points.positions, b.points.positions)
    assert torch.equal(a.points.colours, b.points.colours)
    assert torch.equal(a.points.track_starts, b.points.track_starts)
    assert torch.equal(a.points.track_views, b.points.track_views)


def test_text_binary_with_and_without_rigs_are_one_scene(tmp_path):
    binary = open_scene(write_scene(tmp_path / "binary", FLIGHT), protocol(hold=3))
    text = open_scene(str(write_scene(tmp_path / "text", FLIGHT, text=True)), protocol(hold=3))
    old = open_scene(write_scene(tmp_path / "old", FLIGHT, rigs=False), protocol(hold=3))
    same(binary, text)
    same(binary, old)
    assert binary.test == (0, 3)
    assert binary.name == "binary"
    assert binary.units == "sfm"
    assert binary.facts["split_sha256"] == split_hash(
        [v.name for v in binary.views], binary.train, (0, 3)
    )
    assert binary.facts["model_sha256"] != text.facts["model_sha256"]


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("name", ["my view {}.png", "IMG {}.png", "a  b/two  blanks {}.png"])
def test_blanks_in_names_of_photos_are_kept(tmp_path, text, name):
    plain = open_scene(write_scene(tmp_path / "plain", FLIGHT), protocol())
    folder = write_scene(tmp_path / "blanks", FLIGHT)
    model = pycolmap.Reconstruction(folder / "sparse/0")
    names = {view_name(i): name.format(f"{i:03d}") for i in range(FLIGHT.views)}
    for image in model.images.values():
        photo = folder / "photos" / names[image.name]
        photo.parent.mkdir(exist_ok=True)
        (folder / "photos" / image.name).rename(photo)
        image.name = names[image.name]
    if text:
        for path in (folder / "sparse/0").iterdir():
            path.unlink()
        model.write_text(folder / "sparse/0")
    else:
        model.write_binary(folder / "sparse/0")
    scene = open_scene(folder, protocol())
    assert [view.name for view in scene.views] == [names[view.name] for view in plain.views]
    assert scene.left_out == ()
    for found, wanted in zip(scene.views, plain.views, strict=True):
        assert torch.equal(found.load(), wanted.load())
    assert torch.equal(scene.points.track_views, plain.points.track_views)


@pytest.mark.parametrize(("model", "photos"), [("sparse", "photos"), ("sparse/0", "images")])
def test_other_folder_names(tmp_path, model, photos):
    folder = write_scene(tmp_path / "s", FLIGHT)
    (folder / "photos").rename(folder / "elsewhere")
    (folder / "elsewhere").rename(folder / photos)
    (folder / "sparse/0").rename(folder / "model")
    (folder / "sparse").rmdir()
    (folder / model).parent.mkdir(exist_ok=True)
    (folder / "model").rename(folder / model)
    scene = open_scene(folder, protocol())
    assert scene.facts["image_folder"] == photos
    assert scene.views[0].load().shape[0] == scene.views[0].camera.height


def test_rigs_with_a_second_sensor_are_read(tmp_path):
    """A rig of two cameras: the second one's pose is its sensor's times the frame's."""
    folder = write_scene(tmp_path / "s", FLIGHT)
    plain = reconstruction(FLIGHT)
    model = pycolmap.Reconstruction()
    first, second = FLIGHT.camera, FLIGHT.camera
    second.camera_id = 2
    model.add_camera(first)
    model.add_camera(second)
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(first.sensor_id)
    offset = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0.02, 0])), np.array([0.1, 0, 0]))
    rig.add_sensor(second.sensor_id, offset)
    model.add_rig(rig)
    frame = pycolmap.Frame(frame_id=1, rig_id=1, rig_from_world=plain.image(1).cam_from_world())
    frame.add_data_id(pycolmap.data_t(first.sensor_id, 1))
    frame.add_data_id(pycolmap.data_t(second.sensor_id, 2))
    model.add_frame(frame)
    for number in (1, 2):
        image = pycolmap.Image(name=view_name(number - 1), camera_id=number, image_id=number)
        image.frame_id = 1
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([3.0, 4.0]))])
        model.add_image(image)
    track = pycolmap.Track([pycolmap.TrackElement(1, 0), pycolmap.TrackElement(2, 0)])
    model.add_point3D(np.array([0.0, 0.0, 0.0]), track, np.zeros(3, dtype=np.uint8))
    for path in (folder / "sparse/0").iterdir():
        path.unlink()
    model.write_binary(folder / "sparse/0")
    scene = open_scene(folder, protocol())
    expected = offset * plain.image(1).cam_from_world()
    found = scene.views[1].camera.world_to_camera[:3].numpy()
    assert found == pytest.approx(expected.matrix(), abs=1e-12)
    assert [view.sensor for view in scene.views] == ["camera 1", "camera 2"]
    times = {view_name(0): {"time": 0}, view_name(1): {"time": 0, "sensor": "right"}}
    (folder / "views.json").write_text(json.dumps(times))
    timed = open_scene(folder, protocol()).views
    assert [view.sensor for view in timed] == ["camera 1", "right"]


def test_far_coordinates_are_shifted_in_float64(tmp_path):
    near = open_scene(write_scene(tmp_path / "near", FLIGHT), protocol())
    utm = (448_262.0, 5_411_932.0, 120.0)
    moved = open_scene(write_scene(tmp_path / "far", Flight(views=6, offset=utm)), protocol())
    assert torch.equal(near.shift, torch.zeros(3, dtype=torch.float64))
    centres = torch.stack([view.camera.centre for view in moved.views])
    assert centres.mean(0).abs().max() < 1e-6
    back = moved.points.positions + moved.shift
    assert (back - near.points.positions - torch.tensor(utm).double()).abs().max() < 2e-9
    for a, b in zip(near.views, moved.views, strict=True):
        first, _ = project_points(a.camera, near.points.positions)
        second, _ = project_points(b.camera, moved.points.positions)
        # t = -R C at 5e6 units has 1e-9 of rounding, at 4 units from the ground and f = 70
        assert (first - second).abs().max() < 1e-6


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1e-2])
def test_a_scene_of_small_numbers_lies_behind_its_near_plane(tmp_path, scale):
    folder = write_scene(tmp_path / "s", FLIGHT)
    model = pycolmap.Reconstruction(folder / "sparse/0")
    model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3)))
    model.write_binary(folder / "sparse/0")
    scene = open_scene(folder, protocol())
    for view in scene.views:
        _, depth = project_points(view.camera, scene.points.positions)
        assert depth.min() > view.camera.near


def test_points_that_only_test_views_see_can_be_dropped(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    held = tuple(view_name(i) for i in (0, 3))
    every = open_scene(folder, protocol(test_names=held))
    dropped = open_scene(folder, protocol(test_names=held, drop_test_points=True))
    starts = every.points.track_starts.tolist()
    tracks = [set(every.points.track_views[a:b].tolist()) for a, b in pairwise(starts)]
    keep = [i for i, track in enumerate(tracks) if not track <= {0, 3}]
    assert 0 < len(keep) < len(tracks)
    assert torch.equal(dropped.points.positions, every.points.positions[keep])
    starts = dropped.points.track_starts.tolist()
    found = [set(dropped.points.track_views[a:b].tolist()) for a, b in pairwise(starts)]
    assert found == [tracks[i] for i in keep]
    assert dropped.facts["points"] == f"{len(keep)} of {len(tracks)}"


def test_unregistered_photos_are_listed_and_their_observations_left_out(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    model = pycolmap.Reconstruction(folder / "sparse/0")
    model.deregister_frame(model.image(2).frame_id)
    model.write_binary(folder / "sparse/0")
    extra = Image.new("RGB", (96, 72))
    extra.save(folder / "photos/extra.jpg")
    (folder / "photos/notes.txt").write_text("not a photo")
    write_scene_file(
        folder, SceneFile(left_out={"extra.jpg": "too dark", "gone.jpg": "unreadable"})
    )
    scene = open_scene(folder, protocol())
    assert [view.name for view in scene.views] == [view_name(i) for i in (0, 2, 3, 4, 5)]
    assert dict(scene.left_out) == {
        "extra.jpg": "too dark",
        "gone.jpg": "unreadable",
        view_name(1): "structure from motion did not register it",
    }
    assert int(scene.points.track_views.max()) < len(scene.views)


@pytest.mark.parametrize("text", [False, True])
def test_photos_of_another_model_beside_are_said_to_be_in_it(tmp_path, text):
    folder = write_scene(tmp_path / "s", FLIGHT)
    for place, kept in (("0", (0, 1)), ("1", (2, 3, 4))):
        model = reconstruction(FLIGHT)
        for image in list(model.images.values()):
            if image.name not in [view_name(i) for i in kept]:
                model.deregister_frame(image.frame_id)
        (folder / "sparse" / place).mkdir(exist_ok=True)
        (model.write_text if text and place == "1" else model.write_binary)(
            folder / "sparse" / place
        )
    (folder / "sparse/2").mkdir()
    (folder / "sparse/2/images.bin").write_bytes(b"damaged")
    scene = open_scene(folder, protocol())
    elsewhere = "is in sparse/1, another model, of 3 photos; sparse/0 is used, of 2"
    assert dict(scene.left_out) == {
        **dict.fromkeys((view_name(i) for i in (2, 3, 4)), elsewhere),
        view_name(5): "structure from motion did not register it",
    }


def test_photos_that_are_not_there_are_left_out_unless_the_protocol_is_strict(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    whole = open_scene(folder, protocol(hold=3))
    gone = [folder / "photos" / view_name(i) for i in (1, 4)]
    for path in gone:
        path.unlink()
    Image.new("RGB", (96, 72)).save(folder / "photos/extra.jpg")
    scene = open_scene(folder, protocol(hold=3))
    kept = [0, 2, 3, 5]
    assert [view.name for view in scene.views] == [view_name(i) for i in kept]
    assert scene.left_out == (
        ("extra.jpg", "structure from motion did not register it"),
        *((path.name, f"its photo is missing: {path}") for path in gone),
    )
    assert torch.equal(scene.points.positions + scene.shift, whole.points.positions + whole.shift)
    assert tracks(scene) == [[view for view in track if view in kept] for track in tracks(whole)]
    for view in scene.views:
        before = next(one for one in whole.views if one.name == view.name)
        assert torch.equal(view.camera.K, before.camera.K)
        assert torch.equal(view.load(), before.load())
    refused(folder, r"photos/photo_001\.png: photo is missing; put it back", strict=True)
    for view in scene.views:
        (folder / "photos" / view.name).unlink()
    refused(folder, r"s/sparse/0: not one photo of its 6 images is there, .*photo_000\.png")


def save_mask(path: Path, mask: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(255 * mask.astype(np.uint8)).save(path)


def test_colmaps_masks_go_with_their_photos(tmp_path):
    """Of one photo by NAME.png, of another by the name that ends in .png; the others are whole."""
    folder = write_scene(tmp_path / "s", FLIGHT)
    bare = open_scene(folder, protocol())
    mask = np.random.default_rng(0).integers(0, 30, (72, 96)) > 0
    save_mask(folder / "masks" / f"{view_name(0)}.png", mask)
    save_mask(folder / "masks" / view_name(0), ~mask)  # COLMAP takes the other one
    save_mask(folder / "masks" / view_name(1), mask)
    # red only where masked: no valid pixel of the truth may have any of it
    red = np.zeros((72, 96, 3), np.uint8)
    red[..., 0] = 255 * ~mask
    for i in (0, 1):
        Image.fromarray(red).save(folder / "photos" / view_name(i))
    for rules in ({}, {"factor": 2.0}):
        scene = open_scene(folder, protocol(**rules))
        for view in scene.views[:2]:
            good = valid(view)
            assert 0.2 < good.float().mean() < 1
            assert view.load()[good].max() < 1e-3
        assert [view.load_mask for view in scene.views[2:]] == [None] * 4
    assert len(scene.sources) == len(bare.sources) + 2
    for found, wanted in zip(open_scene(folder, protocol()).views[2:], bare.views[2:], strict=True):
        assert torch.equal(found.load(), wanted.load())


def test_a_mask_that_allows_nothing_or_is_of_another_size(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    save_mask(folder / "masks" / f"{view_name(0)}.png", np.zeros((72, 96)))
    save_mask(folder / "masks" / f"{view_name(1)}.png", np.ones((70, 96)))
    black, small = open_scene(folder, protocol()).views[:2]
    assert not valid(black).any()
    with pytest.raises(
        DataError, match=r"masks/photo_001\.png\.png: mask is 96 x 70, its photo is"
    ):
        small.load()


def test_masks_of_smaller_copies_lie_in_a_folder_of_their_own(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    (folder / "images_2").mkdir()
    for path in (folder / "photos").iterdir():
        Image.open(path).resize((48, 36)).save(folder / "images_2" / path.name)
    mask = np.arange(72 * 96).reshape(72, 96) % 96 > 30
    name = f"{view_name(0)}.png"
    save_mask(folder / "masks" / name, mask)
    said = rf"s/masks_2: has no mask of 'photo_000\.png', but .*s/masks/{name} is there"
    refused(folder, said, images="images_2")
    save_mask(folder / "masks_2" / name, mask[::2, ::2])
    first, second = open_scene(folder, protocol(images="images_2")).views[:2]
    assert 0.5 < valid(first).float().mean() < 0.8
    assert second.load_mask is None


def tracks(scene: Scene) -> list[list[int]]:
    """Of every point the numbers in the names of the photos that see it."""
    names = [int(view.name[-7:-4]) for view in scene.views]
    starts = scene.points.track_starts.tolist()
    views = scene.points.track_views.tolist()
    return [[names[i] for i in views[a:b]] for a, b in pairwise(starts)]


def test_a_prescaled_folder_gets_cameras_of_its_own_size(tmp_path):
    """images_2: 48 x 36 photos of a 96 x 72 camera, K scaled per axis."""
    folder = write_scene(tmp_path / "s", FLIGHT)
    (folder / "images_2").mkdir()
    for path in (folder / "photos").iterdir():
        Image.open(path).resize((48, 36)).save(folder / "images_2" / path.name)
    full = open_scene(folder, protocol())
    half = open_scene(folder, protocol(images="images_2"))
    assert abs(half.views[0].camera.width - full.views[0].camera.width / 2) <= 1
    assert torch.allclose(half.views[0].camera.K[0, 0], full.views[0].camera.K[0, 0] / 2)
    image = half.views[0].load()
    assert image.shape == (half.views[0].camera.height, half.views[0].camera.width, 3)


def test_scene_file_gives_units_up_and_facts(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    write_scene_file(
        folder, SceneFile(units="metres", up=(0.0, 0.0, 1.0), facts={"made": 'a "test"\n'})
    )
    scene = open_scene(folder, protocol())
    assert scene.units == "metres"
    assert scene.up.tolist() == [0, 0, 1]
    assert scene.facts["made"] == 'a "test"\n'
    assert scene.facts["up_source"] == "scene.toml"


def test_rounded_quaternions_become_rotations(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT, text=True, rigs=False)
    exact = open_scene(folder, protocol())
    path = folder / "sparse/0/images.txt"
    lines = path.read_text().splitlines()
    for i, line in enumerate(lines):
        fields = line.split()
        if line.endswith(".png"):
            lines[i] = " ".join([fields[0], *(f"{float(q):.4f}" for q in fields[1:5]), *fields[5:]])
    path.write_text("\n".join(lines) + "\n")
    for rough, fine in zip(open_scene(folder, protocol()).views, exact.views, strict=True):
        rotation = rough.camera.rotation
        assert (rotation @ rotation.T - torch.eye(3)).abs().max() < 1e-12
        assert (rotation - fine.camera.rotation).abs().max() < 4e-4


def test_the_model_hash_follows_every_file(tmp_path):
    folder = write_scene(tmp_path / "s", FLIGHT)
    before = open_scene(folder, protocol()).facts["model_sha256"]
    assert before == open_scene(folder, protocol(width=20)).facts["model_sha256"]
    data = bytearray((folder / "sparse/0/points3D.bin").read_bytes())
    data[8 + 8 + 24] ^= 1  # red of the first point
    (folder / "sparse/0/points3D.bin").write_bytes(data)
    assert open_scene(folder, protocol()).facts["model_sha256"] != before


def test_opening_decodes_no_photo(tmp_path, monkeypatch):
    folder = write_scene(tmp_path / "s", FLIGHT)
    loaded: list[Path] = []
    real = Image.Image.load
    monkeypatch.setattr(Image.Image, "load", lambda self: loaded.append(self) or real(self))
    scene = open_scene(folder, protocol(width=40))
    assert not loaded
    scene.views[0].load()
    assert loaded
