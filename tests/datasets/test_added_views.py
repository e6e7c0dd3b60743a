"""Test views from a scene of their own: nothing moves, nothing trains on them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.colmap_scenes import Flight, view_name, write_scene
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import DataError
from splatproof.datasets.added_views import with_tests
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.view_times import Moment, write_moments
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, Sweep

RULES = Protocol(name="p", source="test")


def renamed(scene: Scene, prefix: str) -> Scene:
    views = tuple(replace(view, name=prefix + view.name) for view in scene.views)
    return replace(scene, views=views)


def tracked(scene: Scene) -> Scene:
    """Point i is observed by view i modulo their number."""
    count = len(scene.points)
    points = replace(
        scene.points,
        track_starts=torch.arange(count + 1),
        track_views=torch.arange(count) % len(scene.views),
    )
    return replace(scene, points=points)


def test_all_own_views_train_and_tracks_keep_their_views():
    scene = renamed(tracked(tiny_scene()), "m")
    both = with_tests(scene, renamed(tiny_scene(views=2), "a"), RULES)  # sorts before the scene's
    assert [view.name for view in both.test_views] == ["a0.png", "a1.png"]
    assert [view.name for view in both.train_views] == [view.name for view in scene.views]
    names = [both.views[i].name for i in both.points.track_views.tolist()]
    assert names == [scene.views[i].name for i in scene.points.track_views.tolist()]
    assert [view.name for view in both.views] == sorted(view.name for view in both.views)


def test_a_sweep_of_a_test_view_moves_with_its_camera():
    """A point keeps its place in the picture, and its distance from the sensor."""
    scene, tests = renamed(tiny_scene(), "m"), renamed(tiny_scene(views=2), "a")
    sweep = Sweep(
        positions=torch.tensor([[0.2, -0.1, 0.3]]), origin=torch.zeros(3).double(), time=0.5
    )
    tests = replace(
        tests,
        views=tuple(replace(view, load_sweep=lambda: sweep) for view in tests.views),
        shift=torch.tensor([5.0, -3.0, 2.0], dtype=torch.float64),
    )
    for view, own in zip(with_tests(scene, tests, RULES).test_views, tests.views, strict=True):
        assert view.load_sweep is not None
        moved = view.load_sweep()
        assert (moved.time, moved.positions.dtype) == (0.5, torch.float32)
        assert torch.equal(moved.origin, tests.shift)
        seen, _ = project_points(view.camera, moved.positions.double())
        want, _ = project_points(own.camera, sweep.positions.double())
        assert (seen - want).abs().max() < 1e-4  # pixels: float32 of 5 units, 9 pixels a unit
        still, _ = project_points(view.camera, sweep.positions.double())
        assert (still - want).abs().max() > 1  # control: left where it was


@pytest.mark.parametrize("first", [1000.5, 999.0])
def test_times_of_test_views_are_told_from_the_scenes_first_view(tmp_path, first):
    """One clock for both folders: a test view later by half a second is rendered half a second later."""
    opened = []
    for folder, start in (("scene", 1000.0), ("tests", first)):
        root = write_scene(tmp_path / folder, Flight(views=6))
        write_moments(root, {view_name(i): Moment(time=start + 0.25 * i) for i in range(6)})
        (root / "lidar").mkdir()
        for i in range(6):
            points = np.arange(6.0).reshape(2, 3)
            time = start + 0.25 * i + 0.015625
            np.savez(root / f"lidar/{i}.npz", points=points, origin=np.zeros(3), time=time)
        opened.append(open_scene(root, RULES))
    scene, tests = renamed(opened[0], "m"), renamed(opened[1], "t")
    both = with_tests(scene, tests, RULES)
    assert [view.time for view in both.train_views] == [0.25 * i for i in range(6)]
    later = first - 1000
    assert [view.time for view in both.test_views] == [later + 0.25 * i for i in range(6)]
    for view, own in zip(both.test_views, tests.views, strict=True):
        assert view.load_sweep is not None
        assert own.sweep_time is not None
        assert view.sweep_time == view.load_sweep().time == own.sweep_time + later


def test_fewer_views_train_and_the_tests_stay():
    scene, tests = renamed(tiny_scene(), "m"), renamed(tiny_scene(views=2), "a")
    few = with_tests(scene, tests, replace(RULES, train_views=2))
    own = [view.name for view in scene.views]
    assert [view.name for view in few.train_views] == [own[0], own[-1]]
    assert [view.name for view in few.test_views] == ["a0.png", "a1.png"]
    all_of_it = with_tests(scene, tests, RULES)
    assert few.facts["split_sha256"] != all_of_it.facts["split_sha256"]
    fitted = with_tests(scene, tests, replace(RULES, scored="training"))
    assert fitted.test == fitted.train == all_of_it.train


def test_another_shift_of_the_test_views_changes_no_pixel():
    scene = replace(tiny_scene(), shift=torch.tensor([100.0, 20.0, 5.0], dtype=torch.float64))
    away = torch.tensor([103.0, 18.0, 5.5], dtype=torch.float64)
    pose = camera(0).world_to_camera.clone()
    pose[:3, 3] += pose[:3, :3] @ (away - scene.shift)  # the same camera, told from `away`
    tests = renamed(replace(tiny_scene(views=1), shift=away, train=(0,), test=()), "t")
    view = replace(tests.views[0], camera=replace(camera(0), world_to_camera=pose))
    both = with_tests(scene, replace(tests, views=(view,)), RULES)
    points = scene.points.positions
    want, _ = project_points(camera(0), points)
    found, _ = project_points(both.test_views[0].camera, points)
    assert torch.allclose(found, want, atol=1e-9)


def test_names_in_both_and_other_units_are_refused():
    with pytest.raises(DataError, match=r"test view '0\.png' has the name of a training view"):
        with_tests(tiny_scene(), tiny_scene(views=1), RULES)
    with pytest.raises(DataError, match="units are 'metres', the scene's 'sfm'"):
        with_tests(tiny_scene(), replace(renamed(tiny_scene(), "t"), units="metres"), RULES)


def test_a_scene_without_the_folder_is_refused(tmp_path):
    with pytest.raises(DataError, match="no such folder, but protocol 'p' takes its test views"):
        open_scene(tmp_path, Protocol(name="p", source="test", test_folder="unseen"))
