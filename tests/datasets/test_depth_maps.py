"""Depth beside photos."""

import numpy as np
import pytest
import torch

from splatproof.base.errors import DataError
from splatproof.datasets.depth_maps import depth_loader, depth_path

DEPTH = np.arange(48, dtype=np.float32).reshape(6, 8)
DEPTH[0, 0] = np.inf


@pytest.fixture
def scene(tmp_path):
    path = depth_path(tmp_path, "left/a.png")
    path.parent.mkdir(parents=True)
    np.savez_compressed(path, depth=DEPTH)
    return tmp_path


def test_depth_of_a_photo_in_a_folder(scene):
    load = depth_loader(scene, "left/a.png", (8, 6), (8, 6))
    assert load is not None
    assert torch.equal(load(), torch.from_numpy(DEPTH))
    assert depth_loader(scene, "left/b.png", (8, 6), (8, 6)) is None


def test_a_smaller_view_takes_the_pixel_under_its_centre(scene):
    load = depth_loader(scene, "left/a.png", (8, 6), (4, 2))
    assert load is not None
    # centres of 4 x 2 pixels lie at columns 1, 3, 5, 7 (from 8) and rows 1.5, 4.5 (from 6)
    assert torch.equal(load(), torch.from_numpy(DEPTH[[1, 4]][:, [1, 3, 5, 7]]))


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"PK rubbish"),
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        lambda path: np.savez(path, other=DEPTH),
        lambda path: np.savez(path, depth=DEPTH[:5]),
        lambda path: np.savez(path, depth=DEPTH.astype(np.float64)),
        lambda path: np.savez(path, depth=np.array([object()])),
    ],
)
def test_a_damaged_file_is_named(scene, damage):
    path = depth_path(scene, "left/a.png")
    damage(path)
    load = depth_loader(scene, "left/a.png", (8, 6), (8, 6))
    assert load is not None
    with pytest.raises(DataError, match=r"left/a\.npz") as caught:
        load()
    assert "\n" not in str(caught.value)
