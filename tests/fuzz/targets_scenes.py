"""Targets: scenes as other tools write them."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

from fuzz import layouts
from fuzz.layout import BINARY, JSON, TEXT, Layout
from fuzz.target import Target
from helpers.colmap_scenes import Flight, write_scene
from helpers.posed_scenes import opengl_to_world
from splatproof.datasets import view_times
from splatproof.datasets.adapters.kitti_boxes import read_labels, read_tracklets
from splatproof.datasets.adapters.llff import open_llff
from splatproof.datasets.adapters.photo_tourism import read_split
from splatproof.datasets.adapters.ply_points import read_ply_points
from splatproof.datasets.adapters.transforms import open_blender, open_nerfstudio
from splatproof.datasets.array_files import read_arrays
from splatproof.datasets.colmap_model import read_model
from splatproof.datasets.scene_file import SceneFile, read_scene_file, write_scene_file
from splatproof.datasets.sparse_points import read_points
from splatproof.datasets.view_times import Moment, read_moments, write_moments
from splatproof.metrics.protocol_files import load_protocol

FLIGHT = Flight(views=3, points=12)
TRACKLETS = """<boost_serialization><tracklets><count>1</count><item><objectType>Car</objectType><h>1.5</h>
<w>1.6</w><l>3.5</l><first_frame>0</first_frame><poses><count>1</count><item><tx>1</tx><ty>2</ty><tz>0</tz>
<rz>0.1</rz></item></poses></item></tracklets></boost_serialization>
"""


def colmap(name: str) -> Callable[[Path], Target]:
    """A file of a COLMAP model, binary or text by its ending; the others are intact."""

    def build(folder: Path) -> Target:
        write_scene(folder, FLIGHT, text=name.endswith(".txt"))
        path = folder / "sparse/0" / name
        return Target(
            path=path, samples=[path.read_bytes()], read=_read_colmap, named=False,
            layout=TEXT if name.endswith(".txt") else BINARY,
        )  # fmt: skip

    return build


def _read_colmap(path: Path) -> object:
    return read_points(read_model(path.parent))


def transforms(folder: Path) -> Target:
    """Nerfstudio's transforms.json, with masks, a split and points."""
    frames = []
    write_scene(folder, FLIGHT)
    for i, photo in enumerate(sorted((folder / "photos").iterdir())):
        frames.append(
            {"file_path": f"photos/{photo.name}", "transform_matrix": opengl_to_world(i).tolist()}
        )
    (folder / "points.ply").write_bytes(_points("binary"))
    camera = {"w": 96, "h": 72, "fl_x": 70.0, "fl_y": 71.0, "cx": 48.0, "cy": 36.0}
    names = [frame["file_path"] for frame in frames]
    split = {"train_filenames": names[1:], "test_filenames": names[:1]}
    bent = {
        "k1": 0.1,
        "k2": 0.0,
        "p1": 0.001,
        "camera_model": "OPENCV",
        "ply_file_path": "points.ply",
    }
    plain, whole = {**camera, "frames": frames}, {**camera, **bent, **split, "frames": frames}
    return Target(
        path=folder / "transforms.json", samples=[_json(plain), _json(whole)], layout=JSON,
        read=lambda path: open_nerfstudio(path.parent, load_protocol("default")).points, named=False,
    )  # fmt: skip


def blender(folder: Path) -> Target:
    """NeRF's transforms_train.json; the one of the test views is intact."""
    write_scene(folder, FLIGHT)
    frames = [
        {"file_path": f"./photos/{photo.stem}", "transform_matrix": opengl_to_world(i).tolist()}
        for i, photo in enumerate(sorted((folder / "photos").iterdir()))
    ]
    text = {"camera_angle_x": 0.8, "frames": frames[:2]}
    (folder / "transforms_test.json").write_bytes(_json({**text, "frames": frames[2:]}))
    return Target(
        path=folder / "transforms_train.json", samples=[_json(text)], layout=JSON,
        read=lambda path: open_blender(path.parent, load_protocol("default")).points, named=False,
    )  # fmt: skip


def llff(folder: Path) -> Target:
    """LLFF's poses_bounds.npy."""
    write_scene(folder, FLIGHT)
    (folder / "photos").rename(folder / "images")
    rows = []
    for i in range(FLIGHT.views):
        x, y, z, t = opengl_to_world(i)[:3].T
        rows.append(np.r_[np.stack([-y, x, z, t, [72, 96, 70]], axis=1).ravel(), 1.0, 5.0])
    return Target(
        path=folder / "poses_bounds.npy", samples=[_npy(np.stack(rows))], layout=BINARY,
        read=lambda path: open_llff(path.parent, load_protocol("default")).points, named=False,
    )  # fmt: skip


def points(folder: Path) -> Target:
    """Points as .ply, text and binary, with and without colours."""
    return Target(
        path=folder / "points.ply", samples=[_points("binary"), _points("ascii"), _points("bare")],
        layout=layouts.PLY, read=read_ply_points,
    )  # fmt: skip


def arrays(folder: Path) -> Target:
    """Arrays of an .npz, stored and deflated."""
    samples = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, depth=np.ones((3, 4), np.float32), ids=np.arange(5))
        samples.append(file.getvalue())
    return Target(
        path=folder / "arrays.npz", samples=samples, layout=BINARY, finite=False,
        read=lambda path: read_arrays(path, "depth", "ids"),
    )  # fmt: skip


def moments(folder: Path) -> Target:
    """views.json: when each view was taken."""
    table = {f"{i}.png": Moment(time=0.1 * i, sensor="left") for i in range(3)}
    write_moments(folder, table)
    path = folder / view_times.NAME
    return Target(
        path=path, samples=[path.read_bytes()], layout=JSON,
        read=lambda path: read_moments(path.parent, list(table)),
    )  # fmt: skip


def scene_file(folder: Path) -> Target:
    """scene.toml."""
    scene = SceneFile(
        units="metres", up=(0.0, 0.0, 1.0), left_out={"a.jpg": "blurred"}, facts={"by": "us"}
    )
    write_scene_file(folder, scene)
    path = folder / "scene.toml"
    return Target(
        path=path, samples=[path.read_bytes()], layout=TEXT,
        read=lambda path: read_scene_file(path.parent),
    )  # fmt: skip


def _table(name: str, text: str, read: Callable[[Path], object], layout: Layout = TEXT):
    def build(folder: Path) -> Target:
        return Target(path=folder / name, samples=[text.encode()], layout=layout, read=read)

    return build


def _motions() -> list[np.ndarray]:
    return [np.eye(4), np.eye(4)]


LABEL = "0 1 Car 0 0 -1.5 296 161 455 292 2.0 1.8 4.4 -4.5 1.8 13.4 -2.1\n"
SPLIT = "filename\tid\tsplit\tdataset\na.jpg\t1\ttrain\tx\nb.jpg\t2\ttest\tx\n"
SCENES: dict[str, Callable[[Path], Target]] = {
    **{f"colmap {name}": colmap(name) for name in (
        "cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin", "cameras.txt",
        "images.txt", "points3D.txt", "rigs.txt", "frames.txt")},
    "transforms.json": transforms, "blender": blender, "llff": llff, "points ply": points,
    "npz": arrays, "views.json": moments, "scene.toml": scene_file,
    "kitti labels": _table("0000.txt", LABEL * 3, lambda path: read_labels(path, _motions())),
    "kitti tracklets": _table("labels.xml", TRACKLETS, lambda path: read_tracklets(path, _motions())),
    "photo tourism": _table("split.tsv", SPLIT, read_split),
}  # fmt: skip


def _points(kind: str) -> bytes:
    colours = [] if kind == "bare" else [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(4, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f8"), *colours])
    rows["x"] = [0.5, -1, 2, 3]
    file = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], text=kind == "ascii").write(file)
    return file.getvalue()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _json(tree: object) -> bytes:

    return json.dumps(tree).encode()
