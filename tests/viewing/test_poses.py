"""Cameras that nobody took a photo from."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene
from splatproof.viewing.paths import along, orbit
from splatproof.viewing.poses import looking, place_of_scene
from splatproof.viewing.stage import Shown, Stage


def double(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def free(**about):
    told: dict[str, Any] = {"field": 60.0, "width": 32, "height": 24, "near": 0.01} | about
    return looking(double(1, 2, 3), double(0, 0, 2), double(0.5, -1, 0), **told)


def test_what_is_ahead_is_in_the_middle_and_up_is_up():
    camera = free()
    at, z = project_points(camera, torch.stack([double(1, 2, 8), double(1.5, 1, 8)]))
    assert torch.allclose(at[0], double(16, 12))
    assert torch.allclose(z, double(5, 5))
    assert float(at[1, 1]) < 12  # "up" is drawn above
    assert abs(float(at[1, 0]) - 16) < 1e-9
    assert torch.allclose(camera.centre, double(1, 2, 3))
    assert float(torch.linalg.det(camera.rotation)) == pytest.approx(1)


def test_the_field_of_view_is_the_height():
    edge = 5 * math.tan(math.radians(30))
    up = double(0.5, -1, 0) / math.sqrt(1.25)
    at, _ = project_points(free(), (double(1, 2, 8) + edge * up)[None])
    assert float(at[0, 1]) == pytest.approx(0, abs=1e-9)


def test_no_orientation_is_refused():
    with pytest.raises(UsageError, match="two directions"):
        looking(
            double(0, 0, 0),
            double(0, 1, 0),
            double(0, 2, 0),
            field=60.0,
            width=8,
            height=8,
            near=0.1,
        )


def test_the_scenes_middle_is_what_its_cameras_look_at(scene: Scene):
    place = place_of_scene(scene)
    assert float(place.centre.norm()) < 1.0  # a cube of two units around the origin
    assert 3 < place.radius < 5  # cameras stand 4 units away


def test_an_orbit_keeps_height_and_distance_and_looks_at_the_middle(stage: Stage):
    cameras = orbit(stage, 8, width=32, height=24, field=50.0)
    place = stage.place
    heights = [float((c.centre - place.centre) @ place.up) for c in cameras]
    away = [float((c.centre - place.centre).norm()) for c in cameras]
    assert max(heights) - min(heights) < 1e-9
    assert max(away) - min(away) < 1e-9
    for camera in cameras:
        at, z = project_points(camera, place.centre[None])
        assert torch.allclose(at[0], double(16, 12))
        assert float(z) > 0
    opposite = cameras[0].centre + cameras[4].centre - 2 * place.centre
    assert float((opposite - (opposite @ place.up) * place.up).norm()) < 1e-9


def test_a_path_along_cameras_starts_and_ends_at_them(stage: Stage):
    path = along(stage, 11, width=32, height=24, field=50.0)
    for (camera, _), view in zip(
        (path[0], path[-1]), (stage.training[0], stage.training[-1]), strict=True
    ):
        assert torch.allclose(camera.centre, view.camera.centre)
        assert torch.allclose(camera.rotation, view.camera.rotation)
    steps = torch.stack([camera.centre for camera, _ in path]).diff(dim=0).norm(dim=1)
    assert float(steps.max()) < 2 * float(steps.min())


def test_moments_run_along_with_the_cameras(scene: Scene, truth):
    timed = replace(scene, views=tuple(replace(v, time=2.0 * i) for i, v in enumerate(scene.views)))
    path = along(Stage((Shown(name="m", model=truth),), timed), 9, width=8, height=8, field=50.0)
    assert [moment for _, moment in path] == pytest.approx([2, 3, 4, 5, 6, 7, 8, 9, 10])


def test_a_path_along_one_camera_is_refused(scene: Scene, truth):
    lone = Stage((Shown(name="m", model=truth),), replace(scene, train=(1,)))
    with pytest.raises(UsageError, match="expected 2 or more"):
        along(lone, 5, width=8, height=8, field=50.0)
