"""SfM points become Gaussians."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from helpers.tiny_scene import camera, sparse_points, tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.training import initialise
from splatproof.reference.rasterizer.spherical_harmonics import C0
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene, Sweep


def brute_force(points: np.ndarray) -> np.ndarray:
    """Root of the mean of the smallest three squared distances to other points."""
    squared = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    np.fill_diagonal(squared, np.inf)
    nearest = np.sort(squared, axis=1)[:, : min(3, len(points) - 1)]
    return np.sqrt(np.maximum(nearest.mean(axis=1), 1e-7))


@given(count=st.integers(2, 40), far=st.sampled_from([0.0, 4e6]), seed=st.integers(0, 999))
def test_distance_matches_brute_force(count, far, seed):
    points = np.random.default_rng(seed).normal(size=(count, 3)) + far
    got = initialise.neighbour_distance(torch.from_numpy(points), lone=1.0)
    # at 4e6 units a float64 position resolves 5e-10, so distances near 0.1 agree to about 1e-8
    np.testing.assert_allclose(got.numpy(), brute_force(points), rtol=1e-8)


def test_few_and_equal_points_are_finite():
    same = torch.zeros(5, 3, dtype=torch.float64)
    assert initialise.neighbour_distance(same, lone=1.0).tolist() == [1e-7**0.5] * 5
    assert initialise.neighbour_distance(same[:1], lone=0.25).tolist() == [0.25]
    assert initialise.neighbour_distance(same[:0], lone=1.0).shape == (0,)


@pytest.mark.parametrize("unit", [1e-4, 1e-6])
def test_gaussians_of_a_scene_in_a_large_unit_are_as_wide_as_its_points_are_apart(unit):
    points = torch.from_numpy(np.random.default_rng(0).normal(size=(100, 3)))
    points = torch.cat([points, points[:1]])
    got = initialise.neighbour_distance(unit * points, lone=1.0) / unit
    want = initialise.neighbour_distance(points, lone=1.0)
    torch.testing.assert_close(got, want)


def test_duplicates_in_a_large_unit_are_narrow_and_not_all_of_one_place():
    points = 1e-4 * torch.from_numpy(np.random.default_rng(0).normal(size=(100, 3)))
    points = torch.cat([points, points[:1].repeat(3, 1)])
    got = initialise.neighbour_distance(points, lone=1.0)
    assert got[100:].tolist() == [float(got[0])] * 3
    assert 0.02 < float(got[0] / got.median()) < 0.05


def test_colour_opacity_and_rotation():
    scene = tiny_scene()
    model = initialise.from_points(scene, degree=2, opacity=0.1)
    assert model.sh.shape == (40, 9, 3)
    torch.testing.assert_close(
        model.sh[:, 0] * C0 + 0.5, scene.points.colours.float() / 255, atol=1e-6, rtol=0
    )
    assert not model.sh[:, 1:].any()
    torch.testing.assert_close(model.opacities, torch.full((40,), 0.1))
    assert (model.quaternions == torch.tensor([1.0, 0, 0, 0])).all()


def test_extent_is_the_radius_of_the_training_cameras():
    scene = tiny_scene(views=3)  # train: two cameras 0.4 and 0.1 apart in x and y
    assert initialise.extent(scene) == pytest.approx(1.1 * 0.5 * (0.4**2 + 0.1**2) ** 0.5)


def test_extent_of_cameras_in_one_place_comes_from_the_points():
    scene = tiny_scene(views=2)
    distance = (scene.points.positions - camera(1).centre).norm(dim=1).median()
    assert initialise.extent(scene) == pytest.approx(1.1 * float(distance))


def test_cameras_that_turn_about_one_place_stand_in_one_place():
    """Their centres -R^T t differ by rounding: as an extent that would freeze all positions."""
    scene = tiny_scene(views=6)
    centre = torch.tensor([0.1, 0.2, -4.3], dtype=torch.float64)

    def turned(index: int) -> Camera:
        pose, angle = torch.eye(4, dtype=torch.float64), torch.tensor(0.05 * index).double()
        pose[0, :2] = torch.stack([angle.cos(), -angle.sin()])
        pose[1, :2] = torch.stack([angle.sin(), angle.cos()])
        pose[:3, 3] = -pose[:3, :3] @ centre
        return replace(camera(index), world_to_camera=pose)

    views = tuple(replace(view, camera=turned(i)) for i, view in enumerate(scene.views))
    assert len({tuple(view.camera.centre.tolist()) for view in views}) > 1
    distance = (scene.points.positions - centre).norm(dim=1).median()
    found = initialise.extent(replace(scene, views=views))
    assert found == pytest.approx(1.1 * float(distance))


def moved(scene: Scene, move: Callable[[Tensor], Tensor]) -> Scene:
    return replace(scene, points=sparse_points(move(scene.points.positions)))


@pytest.mark.parametrize(
    ("move", "said"),
    [
        (lambda p: p - torch.tensor([0, 0, 99.0]), "behind the cameras; say which axes"),
        (lambda p: p * 1e-3 - torch.tensor([0, 0, 4.0]), "below 0.01 nothing is drawn; give"),
        (lambda p: p + torch.tensor([99.0, 0, 0]), "beside the pictures; are poses and points"),
    ],
)  # fmt: skip
def test_points_that_no_training_photo_shows_are_refused_with_what_is_in_the_way(move, said):
    scene = tiny_scene()
    with pytest.raises(DataError, match=f"'tiny': none of the 5 .* 40 sparse points: .*{said}"):
        initialise.require_sight(moved(scene, move))


def test_one_point_in_one_training_photo_is_enough_and_so_are_sweeps_or_no_points():
    scene = tiny_scene()
    behind = torch.arange(40)[:, None] < 39
    initialise.require_sight(
        moved(scene, lambda p: torch.where(behind, p - torch.tensor([0, 0, 99.0]), 0 * p))
    )
    initialise.require_sight(moved(scene, lambda p: p[:0]))
    sweep = Sweep(positions=torch.zeros(1, 3), origin=torch.zeros(3, dtype=torch.float64))
    swept = tuple(replace(view, load_sweep=lambda: sweep) for view in scene.views)
    initialise.require_sight(moved(replace(scene, views=swept), lambda p: p - 99))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"points": sparse_points(torch.zeros(0, 3, dtype=torch.float64))}, "0 sparse points"),
        ({"train": ()}, "no training views"),
    ],
)
def test_nothing_to_start_from_is_refused(change, said):
    with pytest.raises(DataError, match=said):
        initialise.from_points(replace(tiny_scene(), **change), degree=0, opacity=0.1)


def test_random_points_lie_where_a_training_camera_sees():
    scene = replace(tiny_scene(), points=sparse_points(torch.zeros(0, 3)))
    filled = initialise.with_random_points(scene, 500, seed=3)
    positions = filled.points.positions
    assert len(positions) == 500
    reach = initialise.extent(scene)
    seen, depths = torch.zeros(500, dtype=torch.bool), []
    for view in scene.train_views:
        pixels, depth = project_points(view.camera, positions)
        size = torch.tensor([view.camera.width, view.camera.height])
        seen |= ((pixels >= -1e-6) & (pixels <= size + 1e-6)).all(1) & (depth > 0.0999 * reach)
        depths.append(depth)
    assert seen.all()
    # log10 of the depth is uniform on [-1, 1]: the median of n draws has a deviation of 1 / sqrt(n)
    middle = torch.stack(depths).median().log10() - math.log10(reach)
    assert abs(middle) < 5 / math.sqrt(500)
    assert positions.std(dim=0).min() > 0.1 * reach
    drawn = filled.points.track_views
    assert filled.points.track_starts.tolist() == list(range(501))
    assert set(drawn.tolist()) == set(scene.train)
    for index in scene.train:
        camera_ = scene.views[index].camera
        pixels, _ = project_points(camera_, positions[drawn == index])
        size = torch.tensor([camera_.width, camera_.height])
        assert ((pixels >= -1e-6) & (pixels <= size + 1e-6)).all()
    assert len(initialise.from_points(filled, degree=1, opacity=0.1)) == 500
    again = initialise.with_random_points(scene, 500, seed=3).points
    assert torch.equal(again.positions, positions)
    other = initialise.with_random_points(scene, 500, seed=4).points
    assert not torch.equal(other.positions, positions)


def test_points_are_drawn_in_front_of_cameras_that_all_stand_in_one_place():
    """A panorama without points: its extent is 0, and nothing drawn at 0 would ever be seen."""
    scene = replace(tiny_scene(), points=sparse_points(torch.zeros(0, 3)))
    pose = scene.views[0].camera.world_to_camera
    scene = replace(scene, views=tuple(
        replace(view, camera=replace(view.camera, world_to_camera=pose)) for view in scene.views
    ))  # fmt: skip
    points = initialise.with_random_points(scene, 500, seed=3).points
    depth = project_points(scene.views[0].camera, points.positions)[1]
    assert float(depth.min()) >= 0.1 - 1e-6
    assert float(depth.max()) <= 10 + 1e-6


def test_scenes_with_points_and_settings_without_random_ones_stay_as_they_are():
    scene = tiny_scene()
    assert initialise.with_random_points(scene, 500, seed=0) is scene
    empty = replace(scene, points=sparse_points(torch.zeros(0, 3)))
    assert initialise.with_random_points(empty, 0, seed=0) is empty
    with pytest.raises(DataError, match=r"bench fit --points triangulated.*set random_points"):
        initialise.from_points(empty, degree=0, opacity=0.1)
