"""The adapter on real photos: what is registered, where points land, what is left out."""

from functools import cache

import numpy as np
import pycolmap
import pytest
import torch

from helpers.real_scenes import real_scene
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

pytestmark = pytest.mark.real
FAILED_IN_SENECA = ["img_0482.jpg", "img_0498.jpg", "img_0579.jpg"]


@cache
def opened(name: str, **rules) -> Scene:
    """Once for all tests: a large one takes seconds."""
    return open_scene(real_scene(name), Protocol(name="test", source="test", **rules))


@cache
def colmap(name: str) -> pycolmap.Reconstruction:
    """The scene's model as COLMAP reads it."""
    return pycolmap.Reconstruction(real_scene(name) / "sparse/0")


@pytest.mark.parametrize(
    ("name", "views", "points", "left_out"),
    [
        ("brighton_beach", 18, 4183, []),
        ("caliterra", 75, 24715, []),
        ("seneca", 164, 62785, FAILED_IN_SENECA),
    ],
)
def test_counts_tracks_and_left_out(name, views, points, left_out):
    scene = opened(name, width=250)
    assert len(scene.views) == views
    assert len(scene.points) == points
    assert [photo for photo, _ in scene.left_out] == left_out
    assert all("did not register" in reason for _, reason in scene.left_out)
    assert scene.test == tuple(range(0, views, 8))
    model = colmap(name)
    names = [view.name for view in scene.views]
    for row, number in enumerate(sorted(model.points3D)):
        if row % 500:
            continue
        point = model.point3D(number)
        assert torch.equal(scene.points.positions[row], torch.from_numpy(point.xyz))
        track = {model.image(e.image_id).name for e in point.track.elements}
        first, last = scene.points.track_starts[row : row + 2].tolist()
        assert {names[i] for i in scene.points.track_views[first:last].tolist()} == track


@pytest.mark.parametrize(
    ("name", "undistort"),
    [
        ("brighton_beach", "crop"),
        ("brighton_beach", "keep"),
        ("caliterra", "crop"),
        pytest.param("seneca", "keep", marks=pytest.mark.slow),
    ],
)
def test_points_project_to_their_undistorted_observations(name, undistort):
    """The distance from a point to its observation is the model's reprojection error, no more."""
    scene = opened(name, factor=3.0, undistort=undistort)
    model = colmap(name)
    for view in scene.views[::40]:
        image = model.find_image_with_name(view.name)
        assert image is not None
        assert image.camera is not None
        seen = [p for p in image.points2D if p.has_point3D()]
        world = np.stack([model.point3D(p.point3D_id).xyz for p in seen])
        pixels = np.stack([p.xy for p in seen])
        K = view.camera.K.numpy()
        # the residual in the photo, carried through the same map: exact, so 1e-6 of a pixel
        in_photo = np.asarray(image.camera.img_from_cam(image.cam_from_world() * world))
        there = np.asarray(image.camera.cam_from_img(in_photo)) @ K[:2, :2].T + K[:2, 2]
        projected = project_points(view.camera, torch.from_numpy(world))[0].numpy()
        assert np.abs(projected - there).max() < 1e-6
        observed = np.asarray(image.camera.cam_from_img(pixels)) @ K[:2, :2].T + K[:2, 2]
        assert (
            np.median(np.linalg.norm(projected - observed, axis=1)) < 0.2
        )  # of a pixel of a third of the size: the model's own residual


def test_a_registered_name_opens_the_same_scene(monkeypatch):
    folder = real_scene("brighton_beach")
    monkeypatch.setenv("SPLATPROOF_DATA", str(folder.parent))
    named = open_scene("brighton_beach", Protocol(name="test", source="test"))
    assert named.root == folder
    assert named.facts == opened("brighton_beach").facts


def test_photos_match_their_points():
    """Colours that COLMAP took at the observations are those of the truth at the projections."""
    scene = opened("brighton_beach")
    model = colmap("brighton_beach")
    view = scene.views[8]
    image = model.find_image_with_name(view.name)
    assert image is not None
    truth = view.load()
    world = np.stack([model.point3D(p.point3D_id).xyz for p in image.points2D if p.has_point3D()])
    colour = [model.point3D(p.point3D_id).color for p in image.points2D if p.has_point3D()]
    where, _ = project_points(view.camera, torch.from_numpy(world))

    def difference(dx: float) -> float:
        column = (where[:, 0] + dx).long().clamp(0, view.camera.width - 1)
        row = where[:, 1].long().clamp(0, view.camera.height - 1)
        expected = torch.from_numpy(np.stack(colour)).double() / 255
        return float((truth[row, column] - expected).abs().median())

    assert difference(0.0) < min(difference(-3.0), difference(3.0))


@pytest.mark.parametrize("name", ["brighton_beach", "caliterra", "seneca"])
def test_up_is_against_what_nadir_cameras_look_at(name):
    scene = opened(name, width=250)
    forward = torch.stack([view.camera.rotation[2] for view in scene.views]).mean(0)
    assert scene.up @ forward < -0.95
    assert scene.facts["up_source"] == "camera plane"
    assert scene.up.norm() == pytest.approx(1)
