"""The light of a test view is that of a training view: sensor, then direction, then distance."""

from dataclasses import replace

import torch

from helpers.tiny_scene import camera
from splatproof.reference.types.nearest_view import nearest_view
from splatproof.reference.types.scene import View


def view(name: str, *, x: float = 0.0, sensor: str = "", turned: bool = False) -> View:
    pose = torch.eye(4, dtype=torch.float64)
    if turned:
        pose[:3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]).double())
    pose[:3, 3] = pose[:3, :3] @ torch.tensor([-x, 0.0, 0.0]).double()
    where = replace(camera(0), world_to_camera=pose)
    return View(name=name, camera=where, load=lambda: torch.zeros(1, 1, 3), sensor=sensor)


def test_the_nearest_view_is_of_the_same_sensor_and_direction_first():
    asked = view("asked", sensor="left")
    near_other = view("near, other sensor", x=0.1, sensor="right")
    near_back = view("near, looks back", x=0.2, sensor="left", turned=True)
    alike = view("alike", x=0.5, sensor="left")
    farther = view("farther", x=0.9, sensor="left")
    every = [near_other, near_back, farther, alike]
    assert nearest_view(asked, every).name == "alike"
    assert nearest_view(asked, [near_other, near_back]).name == "near, looks back"
    assert nearest_view(asked, [near_other]).name == "near, other sensor"
