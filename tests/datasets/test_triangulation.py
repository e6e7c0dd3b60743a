"""Points under given poses lie on the true surface, and know nothing of held-out views."""

import io
from dataclasses import replace
from functools import cache
from unittest import mock

import numpy as np
import pycolmap
import pytest
import torch
from scipy.spatial import KDTree

from helpers.colmap_scenes import Flight, write_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base import folders
from splatproof.base.errors import DataError, MissingError
from splatproof.datasets import triangulation
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import aerial, exporting
from splatproof.datasets.procedural import oracle as truth
from splatproof.datasets.triangulation import with_triangulated
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

KIND = "church"
RULES = Protocol(
    name="few", source="test", test_names=("test_*",), train_views=5, points="triangulated"
)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))


@cache
def world():
    """Its triangles, which take seconds to build."""
    return aerial.SCENES[KIND](0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One of the small aerial scenes: the views that `RULES` takes, with fewer samples a pixel and coarser sky light."""
    built = world()
    with mock.patch.dict(aerial.SCENES, {KIND: lambda seed: built}, clear=True):
        plan = aerial.plan(0, replace(aerial.PRESETS["small"], tests=1, cell=12.0))
    taken = {"test_00.png", *(f"train_{number:02d}.png" for number in range(0, 9, 2))}
    shots = tuple(shot for shot in plan.shots if shot.name in taken)
    plan = replace(plan, shots=shots, samples=2)
    return exporting.make_scene(plan, tmp_path_factory.mktemp("aerial") / "scene") / KIND


@cache
def surface():
    return truth.surface_cloud(world(), 2.0, 0)  # a million points


def surface_error(scene: Scene) -> np.ndarray:
    """Distance of each point from the true surface, in pixels of its nearest view's footprint."""
    cloud = surface()
    points = (scene.points.positions + scene.shift).numpy()
    near, rows = KDTree(cloud.points).query(points, k=8)
    offsets = points[:, None] - cloud.points[rows]
    plane = np.abs(np.einsum("nki,nki->nk", offsets, cloud.normals[rows])).min(axis=1)
    # beyond the spacing of the cloud a plane says nothing
    away = np.where(near.min(axis=1) < 1.5, plane, near.min(axis=1))
    depths = [project_points(view.camera, scene.points.positions)[1] for view in scene.train_views]
    focal = float(scene.views[0].camera.K[0, 0])
    return away * focal / torch.stack(depths).amin(dim=0).numpy()


def test_points_lie_on_the_true_surface(folder):
    scene = open_scene(folder, RULES)
    assert len(scene.points) > 100
    assert scene.facts["points"] == f"{len(scene.points)} triangulated from 5 training views"
    error = surface_error(scene)
    # SIFT finds a place to a fraction of a pixel; views 25 degrees apart stretch that about twice
    # along the ray. A few matches of two views are wrong and nothing tells.
    assert np.median(error) < 0.5
    assert (error < 2.5).mean() > 0.9
    starts, members = scene.points.track_starts, scene.points.track_views
    assert int(starts.diff().min()) >= 2
    assert set(members.tolist()) <= set(scene.train)
    for index in scene.train:  # each point is where its views saw it
        rows = torch.repeat_interleave(torch.arange(len(scene.points)), starts.diff())
        seen = scene.points.positions[rows[members == index]]
        camera = scene.views[index].camera
        pixel, depth = project_points(camera, seen)
        assert bool((depth > 0).all())
        assert bool(((pixel > -4) & (pixel < torch.tensor([212.0, 160.0]))).all())


def test_under_wrong_poses_points_are_far_off(folder):
    """The control: the check above can fail."""
    scene = open_scene(folder, replace(RULES, points="scene"))
    views = list(scene.views)
    turned = torch.eye(4, dtype=torch.float64)
    turned[:2, :2] = torch.tensor([[0.9986, -0.0523], [0.0523, 0.9986]])  # 3 degrees of roll
    for index in scene.train[::2]:
        camera = views[index].camera
        pose = turned @ camera.world_to_camera
        views[index] = replace(views[index], camera=replace(camera, world_to_camera=pose))
    error = surface_error(with_triangulated(replace(scene, views=tuple(views))))
    assert np.median(error) > 0.5
    assert (error < 2.5).mean() < 0.9


def test_held_out_photos_and_the_scenes_own_points_do_not_matter(folder, monkeypatch):
    scene = open_scene(folder, RULES)
    spoilt = [
        replace(view, load=lambda: pytest.fail("read")) if i not in scene.train else view
        for i, view in enumerate(scene.views)
    ]
    monkeypatch.setattr(triangulation, "_triangulate", lambda *_: pytest.fail("not cached"))
    again = with_triangulated(replace(scene, views=tuple(spoilt), points=tiny_scene().points))
    assert torch.equal(again.points.positions, scene.points.positions)
    assert torch.equal(again.points.track_views, scene.points.track_views)


def test_the_same_views_give_the_same_points_again(folder, monkeypatch, tmp_path):
    first = open_scene(folder, RULES)
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "empty"))
    second = open_scene(folder, RULES)
    assert torch.equal(first.points.positions, second.points.positions)
    assert torch.equal(first.points.colours, second.points.colours)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_points_that_were_cut_short_in_the_cache_are_made_again(
    folder, tmp_path, monkeypatch, share
):
    scene, buffer = open_scene(folder, replace(RULES, points="scene")), io.BytesIO()
    np.savez(
        buffer, positions=np.ones((200, 3)), colours=np.zeros((200, 3), np.uint8),
        track_starts=np.arange(0, 402, 2), track_views=np.array([0, 1] * 200),
    )  # fmt: skip
    monkeypatch.setattr(triangulation, "_triangulate", lambda *_: buffer.getvalue())
    first = with_triangulated(scene).points
    (kept,) = (tmp_path / "cache/triangulated").glob("*.npz")
    whole = kept.read_bytes()
    kept.write_bytes(whole[: int(share * len(whole))])
    again = with_triangulated(scene).points
    assert torch.equal(again.positions, first.positions)
    assert kept.read_bytes() == whole


def test_a_full_disk_is_told_before_native_code_ends_the_process(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "RESERVE", 2**62)
    with pytest.raises(MissingError, match="MB are free.*; make room, or let TMPDIR be a folder"):
        open_scene(folder, RULES)
    assert not list((tmp_path / "cache").rglob("*.npz"))


def test_masked_pixels_give_no_points(folder):
    scene = open_scene(folder, replace(RULES, points="scene"))
    mask = torch.zeros(156, 208, dtype=torch.bool)
    mask[:, :110] = True
    views = tuple(replace(view, load_mask=lambda: mask) for view in scene.views)
    found = with_triangulated(replace(scene, views=views))
    assert len(found.points) > 20
    for index in found.train:
        members = found.points.track_views == index
        rows = torch.repeat_interleave(
            torch.arange(len(found.points)), found.points.track_starts.diff()
        )
        pixel, _ = project_points(found.views[index].camera, found.points.positions[rows[members]])
        assert bool((pixel[:, 0] < 110 + 4).all())  # the residual that triangulation allows


def test_a_model_of_poses_alone_is_opened(tmp_path):
    folder = tmp_path / "scene"
    grid = np.random.default_rng(0).random((60, 60, 3))

    def paint(xy: np.ndarray) -> np.ndarray:
        """Tiles of 0.15 units in random colours."""
        column, row = np.floor(xy / 0.15).astype(int).transpose(2, 0, 1) % 60
        return grid[row, column]

    params = [140.0, 144.0, 95.0, 73.0]
    write_scene(folder, Flight(size=(192, 144), model="PINHOLE", params=params, paint=paint))
    with_points = open_scene(folder, Protocol(name="p", source="test", hold=3))
    sparse = folder / "sparse" / "0"
    model = pycolmap.Reconstruction(sparse)
    for number in list(model.point3D_ids()):
        model.delete_point3D(number)
    model.write(sparse)
    with pytest.raises(DataError, match="has no points, .*; `--points triangulated` makes some"):
        open_scene(folder, Protocol(name="p", source="test"))
    scene = open_scene(folder, Protocol(name="p", source="test", hold=3, points="triangulated"))
    assert scene.train == with_points.train
    assert "triangulated from 4 training views" in scene.facts["points"]
    heights = scene.points.positions.add(scene.shift)[:, 2]
    assert len(heights) > 30
    # the painted plane is z = 0; half a pixel from height 4 over a base of 1 is 16 * 0.5 / 140
    assert heights.abs().median() < 0.057


def test_nothing_in_common_gives_no_points_and_one_view_is_refused():
    scene = tiny_scene()
    blank = tuple(
        replace(view, load=lambda view=view: torch.zeros(view.camera.height, view.camera.width, 3))
        for view in scene.views
    )
    found = with_triangulated(replace(scene, views=blank))
    assert (len(found.points), found.points.track_starts.tolist()) == (0, [0])
    with pytest.raises(DataError, match="1 training view, but points are to be triangulated"):
        with_triangulated(replace(scene, train=scene.train[:1]))
