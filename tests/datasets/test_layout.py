"""What an adapter of anybody reads is refused by name where nothing can be made of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatproof.base.errors import DataError
from splatproof.datasets.adapters.posed import pinhole_camera
from splatproof.datasets.layout import Layout, PosedPhoto, check_layout, plain_points

CLOUD = np.array([[0.0, 0, 5], [1, 0, 5], [0, 1, 5]])
GREY = np.full((3, 3), 128, np.uint8)
PHOTO = PosedPhoto(
    name="0.png",
    path=Path("0.png"),
    camera=pinhole_camera(40, 30, 35.0, 35.0, 20.0, 15.0),
    camera_to_world=np.eye(4)[:3],
)
LAYOUT = Layout(adapter="rig", photos=(PHOTO,), points=plain_points(CLOUD, GREY))


def shot(**change: Any) -> Layout:
    return replace(LAYOUT, photos=(PHOTO, replace(PHOTO, name="1.png", **change)))


def with_points(positions: np.ndarray, colours: np.ndarray) -> Layout:
    points = plain_points(CLOUD, GREY)
    cloud = replace(points, positions=torch.from_numpy(positions))
    return replace(LAYOUT, points=replace(cloud, colours=torch.from_numpy(colours)))


def test_what_can_be_used_passes():
    check_layout(LAYOUT, Path("rig.txt"))
    check_layout(replace(LAYOUT, points=None), Path("rig.txt"))


@pytest.mark.parametrize("focal", [-35.0, 0.0, np.nan, np.inf])
def test_a_camera_without_focal_length(focal):
    layout = shot(camera=pinhole_camera(40, 30, focal, 35.0, 20.0, 15.0))
    with pytest.raises(DataError, match=r"rig.txt: the camera of '1.png' .* positive focal"):
        check_layout(layout, Path("rig.txt"))


def test_a_principal_point_that_is_not_finite():
    with pytest.raises(DataError, match=r"the camera of '1.png' .*expected finite"):
        check_layout(shot(camera=pinhole_camera(40, 30, 35.0, 35.0, np.nan, 15.0)), Path("rig.txt"))


def test_a_pose_that_is_not_finite():
    pose = np.eye(4)[:3]
    pose[1, 3] = np.nan
    with pytest.raises(DataError, match=r"the pose of '1.png' .*expected finite"):
        check_layout(shot(camera_to_world=pose), Path("rig.txt"))


def test_points_that_are_not_finite_or_have_colours_from_0_to_1():
    away = CLOUD.copy()
    away[2, 1] = np.inf
    with pytest.raises(DataError, match=r"rig.txt: point 2 \(from 0\) is not finite"):
        check_layout(with_points(away, GREY), Path("rig.txt"))
    # what checks annotated types while tests run is not there for a user
    colours = with_points(CLOUD, GREY)
    assert colours.points is not None
    object.__setattr__(colours.points, "colours", torch.full((3, 3), 0.5))
    with pytest.raises(DataError, match=r"colours are torch.float32, expected torch.uint8"):
        check_layout(colours, Path("rig.txt"))
