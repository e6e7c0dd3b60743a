"""Cameras from JSON: read exactly; broken files refused in one line."""

import json

import pytest
import torch

from helpers.tiny_scene import camera
from splatproof.base.errors import DataError, SplatproofError
from splatproof.methods.storage.camera_files import read_cameras


def entry(index: int, **change):
    one = camera(index)
    return {
        "name": f"{index}.jpg", "width": one.width, "height": one.height, "K": one.K.tolist(),
        "world_to_camera": one.world_to_camera.tolist(),
    } | change  # fmt: skip


def test_cameras_come_back(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([entry(0), entry(3)]))
    found = read_cameras(path)
    assert list(found) == ["0.jpg", "3.jpg"]
    assert torch.equal(found["3.jpg"].camera.world_to_camera, camera(3).world_to_camera)
    assert torch.equal(found["3.jpg"].camera.K, camera(3).K)
    assert (found["0.jpg"].camera.width, found["0.jpg"].camera.height) == (24, 18)
    view = found["3.jpg"]
    assert (view.name, view.time, view.sensor, view.appearance) == ("3.jpg", None, "", None)
    with pytest.raises(SplatproofError, match=r"3\.jpg"):
        view.load()


def test_when_and_in_whose_light_a_camera_looks(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(
        json.dumps([entry(0, time=2, sensor="left", appearance="7.jpg"), entry(1, time=-0.5)])
    )
    first, second = read_cameras(path).values()
    assert (first.time, first.sensor, first.appearance) == (2.0, "left", "7.jpg")
    assert (second.time, second.sensor, second.appearance) == (-0.5, "", None)


FLAT = [[0.0] * 4] * 4


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "not JSON"),
        ("[]", "at least one camera"),
        ("[3]", "camera 0: expected an object"),
        ([entry(0), entry(0)], "camera 1: name '0.jpg'"),
        ([entry(0, width=0)], "width 0, expected"),
        ([entry(0, height=2.5)], "height 2.5, expected"),
        ([entry(0, K=[1, 2])], "K is not a 3 x 3"),
        ([entry(0, K=[[1, 0, 0], [0, 1, 0], [1, 0, 1]])], "K is"),
        ([entry(0, world_to_camera=[[float("nan")] * 4] * 4)], "NaN is no number of JSON"),
        ([entry(0, world_to_camera=FLAT)], "not rigid"),
        ([entry(0, time="noon")], "camera 0: time 'noon', expected a finite number of seconds"),
        ([entry(0, time=None)], "time None"),
        ([entry(0, time=True)], "time True"),
        ([entry(0, time=float("inf"))], "Infinity is no number of JSON"),
        ([entry(0, time=10**400)], "time 1000"),
        ([entry(0, sensor=3)], "sensor 3, expected a name"),
        ([entry(0, appearance="")], "appearance '', expected a name"),
        ([entry(0, tiem=1.0)], "camera 0: unknown 'tiem', did you mean 'time'"),
        ([{"name": "0.jpg", "world_to_camara": []}], "did you mean 'world_to_camera'"),
    ],
)
def test_broken_files_are_refused(tmp_path, content, said):
    path = tmp_path / "cameras.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(DataError, match=said) as error:
        read_cameras(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_absent_file(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_cameras(tmp_path / "cameras.json")
