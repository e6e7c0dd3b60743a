import numpy as np
import pytest

from helpers.adapter_checks import hard_links, opens_in_bounds, protocol, refused, without
from helpers.colmap_scenes import Flight, pose, reconstruction, view_name, write_scene
from helpers.posed_scenes import blob, worst_error
from splatproof.datasets.catalogue.opening import open_scene

FLIGHT = Flight(model="PINHOLE", params=[70, 72, 47, 37])
POINT = np.array([0.5, 0.4, 0.2])
HEADER = "filename\tid\tsplit\tdataset"


def tourism(folder, splits):
    """The scene's folder: dense/ as the challenge ships it, the table as NeRF-W does."""
    write_scene(folder / "dense", FLIGHT)
    (folder / "dense/photos").rename(folder / "dense/images")
    points = {}
    for i, split in enumerate(splits):
        pixel = np.asarray(FLIGHT.camera.img_from_cam((pose(FLIGHT, i) * POINT)[None]))[0]
        blob(folder / "dense/images" / view_name(i), pixel)
        if split:
            points[view_name(i)] = POINT
    rows = [
        f"{view_name(i)}\t{i + 1 if s else ''}\t{s or 'train'}\tset" for i, s in enumerate(splits)
    ]
    (folder / "gate.tsv").write_text("\n".join([HEADER, *rows]) + "\n")
    return points


def test_split_and_points(tmp_path):
    points = tourism(tmp_path, ["train", "test", "train", "", "train", "test"])
    scene = open_scene(tmp_path, protocol())
    assert worst_error(scene, points) < 0.1
    assert [view.name for view in scene.test_views] == [view_name(1), view_name(5)]
    assert scene.facts["split_source"] == "data set"
    assert scene.left_out == ((view_name(3), "the split of NeRF-W does not use it"),)
    tracks = scene.points.track_views
    assert set(tracks.tolist()) == set(range(5))  # of the views that are left
    assert len(open_scene(tmp_path, protocol(drop_test_points=True)).points) <= len(scene.points)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (HEADER, "name\tid", r"gate.tsv: has the columns \['name', 'id'\]"),
        ("photo_002.png\t3\ttrain", "photo_002.png\t3\tval", "line 4 has the split 'val'"),
        ("photo_002.png\t3\ttrain\tset", "photo_002.png\t3", "line 4 has 2 fields"),
        ("photo_002.png", "absent.png", "lists 'absent.png', which the model"),
        ("train", "test", "has no training photo"),
    ],
)
def test_faults_of_the_table(tmp_path, old, new, said):
    tourism(tmp_path, ["train", "test", "train"])
    path = tmp_path / "gate.tsv"
    path.write_text(path.read_text().replace(old, new))
    refused(tmp_path, said)


def test_missing_and_extra_files(tmp_path):
    tourism(tmp_path, ["train", "test", "train"])
    without(tmp_path / "dense/images" / view_name(0), tmp_path, r"photo_000\.png: photo is missing")
    without(tmp_path / "dense/sparse/0/images.bin", tmp_path, r"images\.bin: missing")
    blob(tmp_path / "dense/images/more.png", np.array([3.0, 3.0]))
    left = dict(open_scene(tmp_path, protocol()).left_out)
    assert left["more.png"] == "structure from motion did not register it"
    (tmp_path / "second.tsv").write_text(HEADER)
    refused(tmp_path, "expected one .tsv with the split, found gate.tsv, second.tsv")
    for path in tmp_path.glob("*.tsv"):
        path.unlink()
    refused(tmp_path, "expected one .tsv with the split, found none")


@pytest.mark.slow
def test_five_thousand_views(tmp_path):
    flight = Flight(model="PINHOLE", params=FLIGHT.params, views=5000, points=20)
    (tmp_path / "dense/sparse").mkdir(parents=True)
    reconstruction(flight).write_binary(tmp_path / "dense/sparse")
    blob(tmp_path / "one.png", np.array([5.0, 5.0]))
    names = [view_name(i) for i in range(5000)]
    hard_links(tmp_path / "one.png", [tmp_path / "dense/images" / name for name in names])
    rows = [f"{name}\t{i}\ttrain\tset" for i, name in enumerate(names)]
    (tmp_path / "gate.tsv").write_text("\n".join([HEADER, *rows]))
    opens_in_bounds(tmp_path, 5000)
