"""A diffusion model of depth from a local folder, tried with a tiny one of random weights; its scale, by hand."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch.testing import assert_close

from helpers import tiny_diffusers
from helpers.prior_scenes import plane_depth, plane_scene
from splatproof.base.errors import MissingError
from splatproof.methods.priors import marigold
from splatproof.methods.priors.alignment import LEAST_POINTS
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.marigold import in_disparity
from splatproof.reference.types.scene import DepthPrior, SparsePoints

NOISY = pytest.mark.filterwarnings("default")
"""What the library warns of differs with its version and is not ours."""
CAMERA = plane_scene().views[1].camera


def on_the_plane(rows: range, factor: float = 1.0) -> torch.Tensor:
    """World points through the middles of some pixels, at a factor of their depth."""
    row, column = torch.meshgrid(torch.tensor(rows), torch.arange(2, 22, 4), indexing="ij")
    pixel = torch.stack([column + 0.5, row + 0.5, torch.ones_like(row)], dim=-1).double()
    local = (
        (pixel @ torch.linalg.inv(CAMERA.K).T)
        * factor
        * plane_depth(CAMERA)[row, column, None].double()
    )
    return ((local - CAMERA.translation) @ CAMERA.rotation).reshape(-1, 3)


def test_depth_of_any_scale_and_shift_becomes_the_disparity_of_the_points():
    depth = plane_depth(CAMERA)
    depth[:2] = depth[2:].max()
    prior = in_disparity((depth - 1) / 7, CAMERA, on_the_plane(range(4, 17, 3)))
    assert prior.valid.all()
    assert_close(prior.disparity, 1 / depth, atol=1e-5, rtol=0)


def test_what_would_lie_behind_the_camera_is_not_valid():
    depth = plane_depth(CAMERA)
    depth[:2] = -1.0
    prior = in_disparity(depth, CAMERA, on_the_plane(range(4, 17, 3)))
    assert not prior.valid[:2].any()
    assert prior.valid[2:].all()
    assert not prior.disparity[:2].any()


def test_without_points_that_follow_it_there_is_no_scale_and_nothing_is_said():
    depth = plane_depth(CAMERA)
    depth[:2] = 1.0
    few = on_the_plane(range(4, 17, 3))[: LEAST_POINTS - 1]
    for said, points in ((depth, few), (-depth, on_the_plane(range(4, 17, 3)))):
        prior = in_disparity(said, CAMERA, points)
        assert prior.disparity.shape == depth.shape
        assert not prior.valid.any()
        assert not prior.disparity.any()


def test_a_view_with_few_points_does_not_end_the_run_and_is_told(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    where = on_the_plane(range(4, 17, 3))
    points = SparsePoints(
        positions=where, colours=torch.zeros(len(where), 3, dtype=torch.uint8),
        track_starts=torch.arange(len(where) + 1), track_views=torch.ones(len(where)).long(),
    )  # fmt: skip
    scene = replace(plane_scene(), points=points, train=(1, 2))
    told: list[str] = []
    network = SimpleNamespace(config=SimpleNamespace(prediction_type="depth"))
    monkeypatch.setattr(marigold, "pipeline", lambda *_: network)
    monkeypatch.setattr(marigold, "_said", lambda network, photo, seed: plane_depth(CAMERA))
    (weights := tmp_path / "weights").mkdir()
    given = with_priors(scene, f"marigold:{weights}", 0, say=told.append)
    valid = [view.load_prior().valid for view in given.train_views if view.load_prior]
    assert [bool(one.any()) for one in valid] == [True, False]
    (line,) = told
    assert line.startswith(f"depth prior 'marigold' says nothing of {scene.views[2].name}: ")
    assert f"{LEAST_POINTS} sparse points" in line


@NOISY
def test_a_network_of_disparity_is_taken_at_its_word(tmp_path: Path):
    folder = tiny_diffusers.marigold(tmp_path, "disparity")
    scene = plane_scene()
    prior, again = (marigold.prepare(scene, folder, 0)(1) for _ in range(2))
    assert prior.disparity.shape == scene.views[1].size
    assert prior.valid.all()
    assert prior.disparity.std() > 0
    assert torch.equal(prior.disparity, again.disparity)
    assert not torch.equal(prior.disparity, marigold.prepare(scene, folder, 1)(1).disparity)


@NOISY
def test_a_network_of_depth_is_brought_to_the_scale_of_the_views_points(
    tmp_path: Path, monkeypatch
):
    folder, given = tiny_diffusers.marigold(tmp_path, "depth"), []

    def fit(depth, camera, points):
        given.append((depth.shape, camera, len(points)))
        return DepthPrior(disparity=depth, valid=depth > 0)

    monkeypatch.setattr(marigold, "in_disparity", fit)
    where = on_the_plane(range(4, 17, 3))
    points = SparsePoints(
        positions=where, colours=torch.zeros(len(where), 3, dtype=torch.uint8),
        track_starts=torch.arange(len(where) + 1), track_views=torch.arange(len(where)) % 2,
    )  # fmt: skip
    scene = replace(plane_scene(), points=points)
    marigold.prepare(scene, folder, 0)(1)
    ((shape, camera, count),) = given
    view = scene.views[1]
    assert shape == view.size
    assert camera is view.camera
    assert count == len(where) // 2


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(MissingError, match=r"install splatproof\[priors\], or take 'sweep'"):
        marigold.prepare(plane_scene(), tmp_path, 0)
