"""Cameras from JSON: read exactly; broken files refused in one line."""

import json

import pytest
import torch

from helpers.tiny_scene import camera
from splatproof.base.errors import DataError
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
    assert torch.equal(found["3.jpg"].world_to_camera, camera(3).world_to_camera)
    assert torch.equal(found["3.jpg"].K, camera(3).K)
    assert (found["0.jpg"].width, found["0.jpg"].height) == (24, 18)


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
        ([entry(0, world_to_camera=[[float("nan")] * 4] * 4)], "world_to_camera is not a 4 x 4"),
        ([entry(0, world_to_camera=FLAT)], "not rigid"),
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
