"""The hash of a scene's files sees every content, and neither times nor places."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.colmap_scenes import Flight, write_scene
from splatproof.base.errors import DataError
from splatproof.datasets import fingerprint
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.depth_maps import depth_path
from splatproof.datasets.fingerprint import Known, files_sha256
from splatproof.datasets.view_times import Moment, sky_path, write_moments
from splatproof.reference.types.protocol import Protocol

RULES = Protocol(name="test", source="test")
PHOTOS = [f"photo_{i:03d}.png" for i in range(6)]


@pytest.fixture
def folder(tmp_path):
    scene = write_scene(tmp_path / "town", Flight(model="PINHOLE", params=[70, 72, 47, 37]))
    depth, sky = depth_path(scene, PHOTOS[1]), sky_path(scene, PHOTOS[2])
    for path in (depth, sky):
        path.parent.mkdir()
    np.savez(depth, depth=np.ones((72, 96), np.float32))
    shutil.copy(scene / "photos" / PHOTOS[2], sky)
    write_moments(scene, {name: Moment(time=0.0, sensor="front") for name in PHOTOS})
    (scene / "lidar").mkdir()
    np.savez(scene / "lidar" / "0.npz", time=0.0, points=np.ones((400, 3)), origin=np.zeros(3))
    for kind in ("vehicles", "people"):
        shutil.copytree(scene / "photos", scene / "moving" / kind)
    return scene


def hashed(folder: Path, known: Known | None = None) -> str:
    return files_sha256(open_scene(folder, RULES), {} if known is None else known)


@pytest.mark.parametrize(
    "name",
    [f"photos/{PHOTOS[0]}", f"photos/{PHOTOS[5]}", "depth/photo_001.npz", "sky/photo_002.png",
     "moving/people/photo_003.png", "lidar/0.npz"],
)  # fmt: skip
def test_one_byte_of_any_file_changes_it(folder, name):
    """Of the same size, and with the old time."""
    before = hashed(folder)
    assert hashed(folder) == before
    stat = (folder / name).stat()
    data = bytearray((folder / name).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / name).write_bytes(bytes(data))
    os.utime(folder / name, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert hashed(folder) != before


def test_two_files_that_swap_their_contents_change_it(folder):
    before = hashed(folder)
    first, second = (folder / "photos" / name for name in PHOTOS[:2])
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)
    assert hashed(folder) != before


def test_a_copy_elsewhere_with_other_times_has_the_same(folder, tmp_path):
    other = tmp_path / "elsewhere" / "village"
    shutil.copytree(folder, other, copy_function=shutil.copyfile)
    for path in other.rglob("*.png"):
        os.utime(path, ns=(1, 1))
    assert hashed(other) == hashed(folder)


def test_files_that_are_known_are_not_read_again(folder, monkeypatch):
    known: Known = {}
    before = hashed(folder, known)
    read = []
    real = fingerprint.sha256
    monkeypatch.setattr(fingerprint, "sha256", lambda path: read.append(path.name) or real(path))
    assert hashed(folder, known) == before
    assert not read
    os.utime(folder / "photos" / PHOTOS[3], ns=(1, 1))
    assert hashed(folder, known) == before
    assert read == [PHOTOS[3]]
    shutil.copyfile(folder / "photos" / PHOTOS[3], folder / "photos" / PHOTOS[4])
    assert hashed(folder, known) != before


def test_progress_is_told_and_a_lost_file_is_named(folder):
    seen = []
    scene = open_scene(folder, RULES)
    files_sha256(scene, {}, lambda done, total: seen.append((done, total)))
    files = 6 + 3 + 2 * 6  # photos, a depth map, a sky mask, a sweep, two masks of movers a photo
    assert seen == [(i + 1, files) for i in range(files)]
    (folder / "photos" / PHOTOS[2]).unlink()
    with pytest.raises(DataError, match=r"photo_002\.png: cannot be read: No such file"):
        files_sha256(scene, {})
