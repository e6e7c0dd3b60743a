import json
import math

import numpy as np
import pytest
import torch
from PIL import Image
from plyfile import PlyData, PlyElement

from helpers.adapter_checks import hard_links, opens_in_bounds, protocol, refused, valid
from helpers.posed_scenes import (
    POINTS,
    SIZE,
    blob,
    opengl_rays,
    opengl_to_world,
    worst_error,
)
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene

F, C = (80.0, 84.0), (50.0, 34.0)
K1, K2, P1, P2 = -0.1, 0.02, 0.03, -0.02


def bent(rays):
    x, y = rays.T
    r = x * x + y * y
    d = 1 + K1 * r + K2 * r * r
    return np.stack(
        [
            x * d + 2 * P1 * x * y + P2 * (r + 2 * x * x),
            y * d + P1 * (r + 2 * y * y) + 2 * P2 * x * y,
        ],
        axis=1,
    )


def nerfstudio(folder, *, swap=False, distorted=True, views=4):
    frames, points = [], {}
    for i in range(views):
        pose, point = opengl_to_world(i), POINTS[i % 3]
        rays = opengl_rays(pose, point[None])
        name = f"images/{i}.png"
        blob(folder / name, ((bent(rays) if distorted else rays) * F + C)[0])
        frames.append({"file_path": f"./{name}", "transform_matrix": pose.tolist()})
        points[name] = point
    data = {"camera_model": "OPENCV", "w": SIZE[0], "h": SIZE[1], "fl_x": F[0], "fl_y": F[1]}
    data |= {"cx": C[0], "cy": C[1], "frames": frames}
    if distorted:
        data |= {"k1": K1, "k2": K2, "p1": P2 if swap else P1, "p2": P1 if swap else P2}
    (folder / "transforms.json").write_text(json.dumps(data))
    return points


def test_nerfstudio_with_distortion(tmp_path):
    points = nerfstudio(tmp_path)
    scene = open_scene(tmp_path, protocol(hold=2))
    assert worst_error(scene, points) < 0.1
    assert scene.test == (0, 2)
    nerfstudio(tmp_path, swap=True)
    assert worst_error(open_scene(tmp_path, protocol()), points) > 0.1  # the check can fail


def test_nerfstudio_lists_and_own_intrinsics(tmp_path):
    points = nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    for frame in data["frames"]:
        frame["fl_x"] = data["fl_x"]
    data |= {"fl_x": 1.0, "train_filenames": ["images/0.png", "images/1.png"]}
    data |= {"val_filenames": ["images/3.png"]}
    path.write_text(json.dumps(data))
    scene = open_scene(tmp_path, protocol())
    assert (scene.train, scene.test) == ((0, 1), (2,))
    assert scene.left_out[0][0] == "images/2.png"
    del points["images/2.png"]
    assert worst_error(scene, points) < 0.1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model is 'EQUIRECTANGULAR'"),
        ({"fl_x": None}, "fl_x is None"),
        ({"k4": 0.1}, "k4 is 0.1"),
        ({"frames": 3}, "no list 'frames'"),
        ({"train_filenames": ["no.png"], "test_filenames": []}, "'no.png', which no frame has"),
        ({"w": 90}, "photo is 96 x 72, its camera says 90 x 72"),
    ],
)
def test_nerfstudio_faults(tmp_path, change, said):
    nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DataError, match=said) as caught:
        open_scene(tmp_path, protocol())
    assert "\n" not in str(caught.value)
    path.write_text("{")
    with pytest.raises(DataError, match="transforms.json: not JSON"):
        open_scene(tmp_path, protocol())


def test_a_capture_that_lacks_photos_opens_with_those_that_are_there(tmp_path):
    nerfstudio(tmp_path, views=5)
    for name in ("1.png", "3.png"):
        (tmp_path / "images" / name).unlink()
    scene = open_scene(tmp_path, protocol(hold=2))
    assert [view.name for view in scene.views] == [f"images/{i}.png" for i in (0, 2, 4)]
    assert [name for name, _ in scene.left_out] == ["images/1.png", "images/3.png"]
    assert {reason.partition(": ")[0] for _, reason in scene.left_out} == {"its photo is missing"}
    refused(tmp_path, r"1\.png: photo is missing", strict=True)
    for view in scene.views:
        (tmp_path / view.name).unlink()
    refused(tmp_path, "not one photo of its 5 frames is there, expected .*0.png")


FISHEYE = (0.3, -0.1, 0.05, -0.02)


def fisheye(rays, coefficients=FISHEYE):
    """COLMAP's and OpenCV's fisheye: theta (1 + k1 theta^2 + ...) along the ray's direction."""
    r = np.linalg.norm(rays, axis=1, keepdims=True)
    theta = np.arctan(r)
    bent = theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(coefficients, 1)))
    return rays / r * bent


@pytest.mark.parametrize("said", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_nerfstudio_fisheye(tmp_path, said):
    points = nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    del data["camera_model"]
    data |= said | dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True))
    for i, (name, point) in enumerate(points.items()):
        blob(tmp_path / name, (fisheye(opengl_rays(opengl_to_world(i), point[None])) * F + C)[0])
    path.write_text(json.dumps(data))
    assert worst_error(open_scene(tmp_path, protocol()), points) < 0.1
    path.write_text(json.dumps(data | {"k1": -FISHEYE[0]}))
    assert worst_error(open_scene(tmp_path, protocol()), points) > 0.1
    path.write_text(json.dumps(data | {"p1": 0.1}))
    refused(tmp_path, "a fisheye camera has p1 0.1, p2 0.0; expected 0")


def test_a_capture_of_a_fisheye_with_two_coefficients_is_no_perspective_one(tmp_path):
    points = nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    del data["camera_model"]
    data |= {"k1": 0.3, "k2": -0.1, "k3": 0.0, "k4": 0.0}
    for i, (name, point) in enumerate(points.items()):
        rays = opengl_rays(opengl_to_world(i), point[None])
        blob(tmp_path / name, (fisheye(rays, (0.3, -0.1)) * F + C)[0])
    path.write_text(json.dumps(data | {"is_fisheye": True}))
    assert worst_error(open_scene(tmp_path, protocol()), points) < 0.1
    path.write_text(json.dumps(data | {"is_fisheye": False}))
    assert worst_error(open_scene(tmp_path, protocol()), points) > 0.1


def test_a_capture_that_gives_its_field_of_view_alone(tmp_path):
    """As instant-ngp's captures may: the size is the photo's, the centre its middle, pixels are square."""
    nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    said = json.loads(path.read_text())
    for name in ("w", "h", "fl_x", "fl_y", "cx", "cy"):
        del said[name]
    path.write_text(json.dumps(said | {"camera_angle_x": 1.0}))
    camera = open_scene(tmp_path, protocol()).views[0].camera
    focal = camera.width / (2 * math.tan(0.5))
    expected = torch.tensor(
        [[focal, 0, camera.width / 2], [0, focal, camera.height / 2], [0, 0, 1]]
    )
    torch.testing.assert_close(camera.K.float(), expected)
    path.write_text(json.dumps(said | {"camera_angle_x": 1.0, "camera_angle_y": 0.5, "cx": 3.0}))
    camera = open_scene(tmp_path, protocol()).views[0].camera
    expected[1, 1] = camera.height / (2 * math.tan(0.25))
    expected[0, 2] = 3.0
    torch.testing.assert_close(camera.K.float(), expected)
    path.write_text(json.dumps(said | {"camera_angle_x": 3.2}))
    refused(tmp_path, "camera_angle_x is 3.2, expected radians below pi")
    path.write_text(json.dumps(said))
    refused(tmp_path, "fl_x is None")


def test_nerfstudio_points(tmp_path):
    nerfstudio(tmp_path)
    path, cloud = tmp_path / "transforms.json", tmp_path / "sparse_pc.ply"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"ply_file_path": cloud.name}))
    refused(tmp_path, r"sparse_pc.ply: missing")
    rows = [(*xyz, 10 * i, 20, 30) for i, xyz in enumerate(POINTS)]
    kinds = [*((axis, "f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    vertices = PlyElement.describe(np.array(rows, dtype=kinds), "vertex")
    PlyData([vertices]).write(cloud)
    scene = open_scene(tmp_path, protocol())
    torch.testing.assert_close(scene.points.positions, torch.tensor(POINTS), atol=1e-7, rtol=0)
    assert scene.points.colours.tolist() == [[0, 20, 30], [10, 20, 30], [20, 20, 30]]
    before = scene.facts["cameras_sha256"]
    flat = np.array([tuple(row[:2]) for row in rows], dtype=kinds[:2])
    PlyData([PlyElement.describe(flat, "vertex")]).write(cloud)
    refused(tmp_path, r"sparse_pc.ply: vertices have no property 'z', expected x, y, z")
    white = np.array([(*xyz,) for xyz in POINTS], dtype=kinds[:3])
    PlyData([PlyElement.describe(white, "vertex")], text=True).write(cloud)
    scene = open_scene(tmp_path, protocol())
    assert scene.points.colours.unique().tolist() == [128]
    assert scene.facts["cameras_sha256"] != before
    cloud.write_bytes(b"ply\nrubbish")
    refused(tmp_path, r"sparse_pc.ply: not a whole .ply file")


def test_nerfstudio_masks(tmp_path):
    nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    data["frames"][0]["mask_path"] = "masks/0.png"
    path.write_text(json.dumps(data))
    refused(tmp_path, r"masks/0.png: mask is missing, but .* frame images/0.png names it")
    mask = np.full((SIZE[1], SIZE[0]), 255, np.uint8)
    mask[:, :10] = 0
    (tmp_path / "masks").mkdir()
    Image.fromarray(mask).save(tmp_path / "masks/0.png")
    first, second = open_scene(tmp_path, protocol()).views[:2]
    assert first.load_mask is not None
    assert second.load_mask is None
    assert torch.equal(valid(first), torch.from_numpy(mask > 0))
    assert not first.load()[:, :10].any()
    half = valid(open_scene(tmp_path, protocol(factor=2.0)).views[0])
    assert (half[:, 5:].all(), half[:, :5].any()) == (True, False)
    Image.fromarray(mask[:5]).save(tmp_path / "masks/0.png")
    with pytest.raises(DataError, match="mask is 96 x 5, its photo is 96 x 72"):
        valid(first)


def test_masks_of_distorted_photos_touch_no_masked_pixel(tmp_path):
    nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    data["frames"][0]["mask_path"] = "mask.png"
    path.write_text(json.dumps(data))
    mask = np.random.default_rng(0).integers(0, 30, (SIZE[1], SIZE[0])) > 0
    Image.fromarray(255 * mask.astype(np.uint8)).save(tmp_path / "mask.png")
    # red only where masked: no valid pixel of the truth may have any of it
    red = np.zeros((*mask.shape, 3), np.uint8)
    red[..., 0] = 255 * ~mask
    Image.fromarray(red).save(tmp_path / "images/0.png")
    view = open_scene(tmp_path, protocol()).views[0]
    good = valid(view)
    assert 0.5 < good.float().mean() < 1
    assert view.load()[good].max() < 1e-3


@pytest.mark.slow
def test_five_thousand_frames_open_lazily(tmp_path):
    nerfstudio(tmp_path, distorted=False)
    path = tmp_path / "transforms.json"
    data = json.loads(path.read_text())
    frame = data["frames"][0]
    hard_links(tmp_path / "images/0.png", [tmp_path / f"images/l{i:04d}.png" for i in range(5000)])
    data["frames"] = [frame | {"file_path": f"images/l{i:04d}.png"} for i in range(5000)]
    path.write_text(json.dumps(data))
    opens_in_bounds(tmp_path, 5000)


def blender(folder):
    points = {}
    focal = SIZE[0] / (2 * np.tan(0.55))
    for split in ("train", "test", "val"):
        frames = []
        for i in range(2):
            pose, point = opengl_to_world(i + 2 * (split == "test")), POINTS[i]
            pixel = opengl_rays(pose, point[None])[0] * focal + np.array(SIZE) / 2
            blob(folder / f"{split}/r_{i}.png", pixel, alpha=True)
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()})
            if split != "val":
                points[f"{split}/r_{i}.png"] = point
        data = {"camera_angle_x": 1.1, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(data))
    return points


def test_blender(tmp_path):
    points = blender(tmp_path)
    scene = open_scene(tmp_path, protocol())
    assert worst_error(scene, points) < 0.1
    assert [view.name for view in scene.test_views] == ["test/r_0.png", "test/r_1.png"]
    assert len(scene.left_out) == 2
    assert len(scene.points) == 0
    red = open_scene(tmp_path, protocol(background=(1.0, 0.0, 0.0))).views[0].load()
    assert torch.equal(red[0, 0], torch.tensor([1.0, 0.0, 0.0]))
    (tmp_path / "transforms_test.json").unlink()
    with pytest.raises(DataError, match="transforms_test.json: no such file"):
        open_scene(tmp_path, protocol())


ORIGIN, SCALE = np.array([20.0, 5e5, -4e6]), 40.0


def mega_nerf(folder):
    """The release's own recipe: RDF world and camera to DRB, centred, scaled, columns swapped."""
    to_drb = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    points = {}
    for i in range(4):
        pose, point = opengl_to_world(i), POINTS[i % 3]
        split = "val" if i == 0 else "train"
        name = f"{split}/rgbs/{i:06d}.jpg"
        blob(folder / name, (opengl_rays(pose, point[None]) * F + C)[0])
        points[name] = to_drb @ point * SCALE + ORIGIN
        rdf = pose[:3, :3] @ np.diag([1.0, -1, -1])
        drb = to_drb @ rdf @ np.linalg.inv(to_drb)
        columns = [drb[:, 1], -drb[:, 0], drb[:, 2], to_drb @ pose[:3, 3]]
        table = {"H": SIZE[1], "W": SIZE[0], "c2w": torch.tensor(np.stack(columns, 1)).float()}
        table |= {"intrinsics": torch.tensor([*F, *C]), "distortion": torch.zeros(4)}
        (folder / split / "metadata").mkdir(parents=True, exist_ok=True)
        torch.save(table, folder / split / f"metadata/{i:06d}.pt")
    table = {"origin_drb": torch.tensor(ORIGIN), "pose_scale_factor": SCALE}
    torch.save(table, folder / "coordinates.pt")
    lines = [f"DJI_{i}.JPG,{i:06d}.pt\n" for i in range(4)]
    (folder / "mappings.txt").write_text("".join(lines))
    return points


def test_mega_nerf(tmp_path):
    points = mega_nerf(tmp_path)
    scene = open_scene(tmp_path, protocol())
    assert worst_error(scene, points) < 0.1
    assert [view.name for view in scene.test_views] == ["val/rgbs/000000.jpg"]
    assert scene.units == "metres"
    assert scene.up.tolist() == [-1, 0, 0]
    assert scene.shift.abs().max() > 1e6
    (tmp_path / "train/metadata/000001.pt").write_bytes(b"junk")
    with pytest.raises(DataError, match=r"000001.pt: not a file of torch.save"):
        open_scene(tmp_path, protocol())
    (tmp_path / "train/metadata/000001.pt").unlink()
    with pytest.raises(DataError, match=r"mappings.txt: line 2 lists '000001.pt'"):
        open_scene(tmp_path, protocol())
    (tmp_path / "mappings.txt").unlink()
    assert open_scene(tmp_path, protocol()).left_out[0][0] == "train/rgbs/000001.jpg"
    (tmp_path / "train/rgbs/000002.jpg").unlink()
    with pytest.raises(DataError, match=r"000002: photo is missing"):
        open_scene(tmp_path, protocol())


def levir_nvs(folder, *, views=4):
    points = {}
    (folder / "Cams").mkdir()
    for i in range(views):
        pose, point = opengl_to_world(i), POINTS[i % 3]
        blob(folder / f"Images/{i:03d}.png", (opengl_rays(pose, point[None]) * F + C)[0])
        points[f"{i:03d}.png"] = point
        w2c = np.linalg.inv(pose @ np.diag([1.0, -1, -1, 1]))
        K = [[F[0], 0, C[0]], [0, F[1], C[1]], [0, 0, 1]]
        rows = [[",".join(f"{v:.9f}" for v in row) for row in m] for m in (w2c, K)]
        lines = ["extrinsic", *rows[0], "", "intrinsic", *rows[1], "", "1.0,9.0"]
        (folder / f"Cams/{i:03d}.txt").write_text("\n".join(lines))
    return points


def test_levir_nvs(tmp_path):
    points = levir_nvs(tmp_path)
    assert worst_error(open_scene(tmp_path, protocol()), points) < 0.1
    Image.new("RGB", SIZE).save(tmp_path / "Images/009.png")
    assert open_scene(tmp_path, protocol()).left_out == (("009.png", "no camera in Cams"),)
    (tmp_path / "Cams/000.txt").write_text("extrinsic 1 2")
    with pytest.raises(DataError, match="000.txt: not a camera of LEVIR-NVS"):
        open_scene(tmp_path, protocol())
