"""Matches read off depth priors: where pixels lie, how sure that is, and the points that come of it."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch
from torch.testing import assert_close

from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.matches import match_by_prior
from splatproof.methods.training.dense_points import with_dense_points
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.supervision.dense_initialisation import DenseSettings
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import DepthPrior, Scene, View
from splatproof.suites.studies.matching import errors

FIRST, SECOND = camera(0, width=48, height=36), camera(2, width=48, height=36)
DEPTH = 5.0


def on_plane(where, depth: float = DEPTH) -> torch.Tensor:
    """World points of a camera's pixels at a z-depth; all cameras here look along z."""
    row, column = torch.meshgrid(
        torch.arange(where.height) + 0.5, torch.arange(where.width) + 0.5, indexing="ij"
    )
    pixel = torch.stack([column, row, torch.ones_like(row)], dim=-1).double()
    return (depth * (pixel @ torch.linalg.inv(where.K).T) - where.translation).reshape(-1, 3)


def view(where, disparity: torch.Tensor | float, valid: torch.Tensor | None = None) -> View:
    maps = torch.as_tensor(disparity).expand(where.height, where.width)
    known = torch.ones_like(maps, dtype=torch.bool) if valid is None else valid
    plain = tiny_scene().views[0]
    prior = partial(DepthPrior, disparity=maps, valid=known)
    return replace(plain, camera=where, load_prior=prior)


NOTHING_SHARED = torch.zeros(0, 3).double()


def test_a_pixel_goes_where_its_point_projects_and_is_sure_where_both_agree():
    """By projection of known points of a plane, not by the function under test."""
    warp, certainty = match_by_prior(
        view(FIRST, 1 / DEPTH), view(SECOND, 1 / DEPTH), NOTHING_SHARED
    )
    at, _ = project_points(SECOND, on_plane(FIRST))
    start, _ = project_points(FIRST, on_plane(FIRST))
    assert_close(warp.reshape(-1, 2).double(), at - start, atol=1e-4, rtol=0)
    inside = ((at >= 0) & (at < torch.tensor([48, 36]))).all(dim=1)
    assert 0.2 < float(inside.double().mean()) < 1
    assert_close(certainty.reshape(-1)[inside], torch.ones(int(inside.sum())), atol=1e-4, rtol=0)
    assert not certainty.reshape(-1)[~inside].any()


@pytest.mark.parametrize("off", [0.02, 0.05])
def test_certainty_falls_with_the_other_photos_disagreement(off):
    _, certainty = match_by_prior(
        view(FIRST, 1 / DEPTH), view(SECOND, (1 + off) / DEPTH), NOTHING_SHARED
    )
    want = math.exp(-0.5 * (off / 0.02) ** 2)
    assert_close(certainty.amax(), torch.tensor(want), atol=1e-4, rtol=0)


def test_the_scale_and_zero_of_a_prior_are_the_shared_points():
    slope = 0.2 + 0.002 * torch.arange(48.0).expand(36, 48)
    true, other = view(FIRST, slope), view(SECOND, 1 / DEPTH)
    row, column = torch.meshgrid(torch.arange(2, 34, 4), torch.arange(2, 46, 4), indexing="ij")
    pixel = torch.stack([column + 0.5, row + 0.5, torch.ones_like(row)], dim=-1).double()
    z = 1 / slope[row, column].double()
    shared = ((pixel @ torch.linalg.inv(FIRST.K).T) * z[..., None]).reshape(
        -1, 3
    ) - FIRST.translation
    warp, _ = match_by_prior(true, other, shared)
    moved, _ = match_by_prior(view(FIRST, 7 * slope - 0.3), other, shared)
    assert_close(moved, warp, atol=1e-2, rtol=0)
    lost, _ = match_by_prior(view(FIRST, 7 * slope - 0.3), other, NOTHING_SHARED)
    assert float((lost - warp).abs().max()) > 1  # the control


def test_what_a_prior_does_not_say_or_calls_sky_is_not_matched():
    silent = torch.ones(36, 48, dtype=torch.bool)
    silent[:, :20] = False
    plane, sky = torch.full((36, 48), 1 / DEPTH), torch.full((36, 48), 1 / DEPTH)
    sky[:, :20] = 0
    whole = match_by_prior(view(FIRST, plane), view(SECOND, plane), NOTHING_SHARED)[1]
    for one in (view(FIRST, plane, silent), view(FIRST, sky)):
        got = match_by_prior(one, view(SECOND, plane), NOTHING_SHARED)[1]
        assert not got[:, :20].any()
        assert torch.equal(got[:, 20:], whole[:, 20:])
    here = match_by_prior(view(FIRST, plane, silent), view(FIRST, 1.0), NOTHING_SHARED)[1]
    assert not here.any()  # nothing stands in for a depth that is not known
    at, _ = project_points(SECOND, on_plane(FIRST))
    for one in (view(SECOND, plane, silent), view(SECOND, sky)):
        got = match_by_prior(view(FIRST, plane), one, NOTHING_SHARED)[1].reshape(-1)
        assert not got[
            at[:, 0] < 20.4
        ].any()  # up to half a pixel beyond, it is mixed with what is not known
        kept = at[:, 0] > 20.6
        assert torch.equal(got[kept], whole.reshape(-1)[kept])


def test_what_lies_behind_the_other_photo_is_not_matched():
    """Mirrored in the plane z = 0 of its own camera, every pixel would land in the image at the depth it knows."""
    behind = replace(FIRST, world_to_camera=FIRST.world_to_camera.clone())
    behind.world_to_camera[2, 3] -= 2 * DEPTH
    first, second = view(FIRST, 1 / DEPTH), view(behind, 1 / DEPTH)
    _, z = project_points(behind, on_plane(FIRST))
    assert_close(z, torch.full_like(z, -DEPTH))
    assert not match_by_prior(first, second, NOTHING_SHARED)[1].any()


@pytest.fixture(scope="module")
def yard() -> Scene:
    scene = open_scene("courtyard", load_protocol("quick"))
    return replace(scene, train=scene.train[:4])


def test_true_depth_bounds_what_photos_give(yard: Scene):
    flow = with_dense_points(yard, 4.0, 2**28, DenseSettings())
    true = with_dense_points(
        with_priors(yard, "oracle", seed=0), 4.0, 2**28, DenseSettings(matcher="prior")
    )
    first = len(yard.points)
    assert len(true.points) > len(flow.points)
    found, photos = errors(true, first=first), errors(flow, first=first)
    # a voxel's mean is no place of a ray, so that even these points are off by some
    assert float(found.median()) < 0.75 * float(photos.median())
    assert float((found > 0.05).double().mean()) < 0.75 * float((photos > 0.05).double().mean())


def test_photos_without_priors_are_refused_with_what_to_do(yard: Scene):
    with pytest.raises(UsageError, match=r"has no depth prior.*--depth-prior.*dense.matcher flow"):
        with_dense_points(yard, 4.0, 2**28, DenseSettings(matcher="prior"))
