"""The courtyard: a COLMAP scene with true depth, made once, the same for a seed."""

import hashlib
import shutil
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from splatproof.base.errors import UsageError
from splatproof.datasets.catalogue import registry
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import courtyard, exporting, worlds
from splatproof.datasets.procedural.daylight import Daylight
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol

TINY = courtyard.Settings(width=64, height=48, oblique=4, nadir=(2, 1), samples=2)
QUICK = replace(TINY, width=32, height=24, samples=1)
"""For what is made again and again: a sixteenth of a picture's rays."""
PROTOCOL = Protocol(name="test", source="ours", hold=4)


def pixels_hash(folder: Path) -> str:
    """Sha256 over the photos' names and pixels, in name order."""
    digest = hashlib.sha256()
    for path in sorted((folder / "photos").glob("*.png")):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert picture is not None
        digest.update(path.name.encode() + picture.tobytes())
    return digest.hexdigest()


def unexpected(done, total):
    raise AssertionError("made again")


@pytest.fixture(scope="module", autouse=True)
def _coarse_light():
    """Sky light known at a sixtieth of the places: most rays of so small a scene go there."""

    def coarse(caster, sky, low, high, cell):
        return Daylight(caster, sky, low, high, 4 * cell)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(courtyard, "Daylight", coarse)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return exporting.make_scene(courtyard.plan(3, TINY), tmp_path_factory.mktemp("made") / "yard")


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return exporting.make_scene(courtyard.plan(3, QUICK), tmp_path_factory.mktemp("quick") / "yard")


@pytest.fixture(scope="module")
def scene(folder):
    return open_scene(folder, PROTOCOL)


def test_the_ordinary_adapter_opens_it(scene):
    assert len(scene.views) == 2 * TINY.oblique + 2
    assert scene.units == "metres"
    assert scene.up.tolist() == [0, 0, 1]
    assert scene.facts["seed"] == "3"
    assert len(scene.points) > 200
    for view in scene.views:
        assert view.load().shape == (48, 64, 3)


def test_the_pictures_are_no_flat_colour(scene):
    for view in scene.views:
        image = view.load()
        assert 0.2 < float(image.mean()) < 0.6
        assert float(image.std()) > 0.08


def test_depth_of_one_view_predicts_the_depth_of_another(scene):
    """Points lifted from a view lie on, or behind, what another view sees; most lie on it."""
    first, other = scene.views[0], scene.views[1]
    depth = first.load_depth()
    v, u = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(64) + 0.5, indexing="ij")
    pixel = torch.stack([u, v, torch.ones_like(u)], dim=-1).double()
    local = pixel @ torch.linalg.inv(first.camera.K).T * depth[..., None].double()
    local = local[torch.isfinite(depth)]
    points = (local - first.camera.translation) @ first.camera.rotation
    place, z = project_points(other.camera, points)
    inside = ((place > 1) & (place < torch.tensor([63, 47]))).all(dim=1) & (z > 0)
    column, row = place[inside].long().T
    seen = other.load_depth()[None]
    nearest = -torch.nn.functional.max_pool2d(-seen, 3, 1, 1)[0, row, column]
    # in front of everything the other view sees around there: only what is thinner than a pixel
    assert float((z[inside] < 0.97 * nearest).double().mean()) < 0.03
    gap = (z[inside] - seen[0, row, column]).abs() / z[inside]
    assert float((gap < 0.03).double().mean()) > 0.2  # the views are a quarter turn apart


def test_sparse_points_reproject_near_their_observations(scene, folder):
    import pycolmap

    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    gaps = []
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            seen = image.points2D[element.point2D_idx]
            gaps.append(np.linalg.norm(image.project_point(point.xyz) - seen.xy))
    # two-dimensional noise of PIXEL_NOISE, less what triangulation fits of it
    assert 0.3 * 1.25 * 0.4 < np.mean(gaps) < 1.25 * 1.25 * 0.4
    assert np.max(gaps) < 16


def test_the_same_seed_gives_the_same_pixels_another_does_not(quick, tmp_path):
    plan = courtyard.plan(3, QUICK)
    again = exporting.make_scene(plan, tmp_path / "again")
    assert pixels_hash(again) == pixels_hash(quick)
    assert not np.array_equal(courtyard.build(4).vertices, courtyard.build(3).vertices)


def test_a_stopped_making_goes_on(quick, tmp_path):
    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    plan = courtyard.plan(3, QUICK)
    out = tmp_path / "yard"
    with pytest.raises(KeyboardInterrupt):
        exporting.make_scene(plan, out, stop)
    assert not out.exists()
    told = []
    exporting.make_scene(plan, out, lambda done, total: told.append(done))
    assert told[0] >= 3
    assert pixels_hash(out) == pixels_hash(quick)
    assert [p.name for p in tmp_path.iterdir()] == ["yard"]
    model = "sparse/0/points3D.bin"
    assert (out / model).read_bytes() == (quick / model).read_bytes()


def test_two_that_make_the_same_scene_at_once_do_not_disturb_each_other(quick, tmp_path):
    plan, out = courtyard.plan(3, QUICK), tmp_path / "yard"
    with ThreadPoolExecutor() as pool:
        second: list[Future[Path]] = []

        def report(done: int, total: int) -> None:
            if not second:
                second.append(pool.submit(exporting.make_scene, plan, out, unexpected))

        exporting.make_scene(plan, out, report)
        assert second[0].result(timeout=60) == out
    assert [p.name for p in tmp_path.iterdir()] == ["yard"]
    assert pixels_hash(out) == pixels_hash(quick)


def test_a_scene_that_is_there_is_left_alone_and_others_are_refused(folder, tmp_path):
    out = tmp_path / "yard"
    shutil.copytree(folder, out)
    exporting.make_scene(courtyard.plan(3, TINY), out, unexpected)
    with pytest.raises(UsageError, match="exists"):
        exporting.make_scene(courtyard.plan(4, TINY), out)
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match="exists"):
        exporting.make_scene(courtyard.plan(3, TINY), tmp_path / "mine")


def test_the_registry_makes_it_once(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path))
    monkeypatch.setitem(courtyard.PRESETS, "small", QUICK)
    first = registry.find_scene("courtyard", lambda done, total: None)
    assert first.name == "courtyard"
    assert first.is_relative_to(tmp_path)
    assert registry.find_scene("courtyard", unexpected) == first


def test_unknown_worlds_and_presets():
    with pytest.raises(UsageError, match="courtyard"):
        worlds.plan("cortyard", "small", 0)
    with pytest.raises(UsageError, match="small, medium, large"):
        worlds.plan("courtyard", "tiny", 0)
