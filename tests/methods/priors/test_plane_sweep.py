"""Planes between two photos: where they carry pixels, how far apart they lie, and when there are none."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from helpers.textured_scene import camera, on_wall, textured_scene, wall_depth
from splatproof.methods.priors import plane_sweep
from splatproof.methods.priors.plane_sweep import (
    FEWEST,
    MOST,
    STEP,
    STRIDE,
    carried,
    pair_of,
    pixels,
    planes_between,
    positions,
    smaller,
)
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import project_points

FIRST, SECOND = camera((0.0, 0.0, 0.0)), camera((0.5, 0.1, 0.1), turn=30)
SHARED = on_wall(FIRST)[4:-4:6, 4:-4:6].reshape(-1, 3)


def test_the_middle_plane_is_the_points_own_whatever_a_few_wrong_ones_say():
    wrong = SHARED.clone()
    wrong[::7] *= 1.5
    for points in (SHARED, wrong):
        planes = planes_between(FIRST, SECOND, points)
        assert planes is not None
        inverse = pixels(FIRST.height, FIRST.width) @ planes.slope
        assert_close(inverse.float(), 1 / wall_depth(FIRST), atol=2e-4, rtol=0)


def test_a_pixel_goes_where_its_point_projects():
    planes = planes_between(FIRST, SECOND, SHARED)
    assert planes is not None
    at = pixels(FIRST.height, FIRST.width)
    scale = 0.8 + 0.4 * torch.rand(1, *at.shape[:2], generator=torch.Generator().manual_seed(0))
    depth = 1 / (scale[0].double() * (at @ planes.slope))
    want, _ = project_points(SECOND, unproject(FIRST, depth))
    found = positions(planes, at, scale)[0]
    back = carried(planes.middle, torch.cat([found, torch.ones_like(found[..., :1])], dim=-1))
    assert_close(back.reshape(-1, 2), want, atol=1e-9, rtol=0)
    still = positions(planes, at, torch.ones_like(scale))[0]
    assert_close(still, at[..., :2], atol=1e-9, rtol=0)


def test_planes_lie_a_step_apart_and_beyond_the_points():
    draw = torch.Generator().manual_seed(1)
    rough = SHARED * (1 + 2 * torch.rand(len(SHARED), 1, generator=draw))
    planes = planes_between(FIRST, camera((2.0, 0.2, 0.0), turn=30), rough.double())
    assert planes is not None
    count = len(planes.scales)
    assert FEWEST < count < MOST
    at = pixels(FIRST.height, FIRST.width)
    ends = positions(planes, at, planes.scales[[0, -1], None, None].expand(2, *at.shape[:2]))
    apart = float((ends[1] - ends[0]).norm(dim=-1).median()) / (count - 1)
    assert 0.8 * STEP < apart < 1.1 * STEP
    where, z = project_points(FIRST, rough.double())
    scale = 1 / z / (torch.cat([where, torch.ones_like(z[:, None])], dim=1) @ planes.slope)
    assert float(planes.scales[0]) < float(scale.min())
    assert float(planes.scales[-1]) > float(scale.max())
    alone = planes_between(FIRST, replace(FIRST), SHARED)  # from one place nothing moves
    assert alone is not None
    assert len(alone.scales) == FEWEST


@pytest.mark.parametrize(
    "points", [SHARED[:7], SHARED @ torch.diag(torch.tensor([1, 1, 0.1])).double()]
)
def test_few_points_and_steep_walls_are_swept_facing_the_photo(points):
    """The second wall is so steep that its horizon is nearly in the photo."""
    if len(points) > 7:
        points = points + torch.tensor([0.0, 0.0, 3.0])
        points[:, 2] += 1.6 * points[:, 0]
    planes = planes_between(FIRST, SECOND, points)
    assert planes is not None
    _, z = project_points(FIRST, points)
    assert_close(planes.slope, torch.stack([z[0] * 0, z[0] * 0, (1 / z).median()]))


def test_there_are_none_without_points_in_front_or_from_the_walls_other_side():
    assert planes_between(FIRST, SECOND, SHARED[:0]) is None
    assert planes_between(FIRST, SECOND, -SHARED) is None
    behind = replace(SECOND, world_to_camera=SECOND.world_to_camera.clone())
    turn = torch.diag(torch.tensor([-1.0, 1, -1, 1], dtype=torch.float64))
    behind.world_to_camera[:] = turn
    behind.world_to_camera[2, 3] = 10  # it looks back at the wall from beyond
    assert (project_points(behind, SHARED)[1] > 0).all()
    assert planes_between(FIRST, behind, SHARED) is None


def test_neither_unit_nor_place_of_the_scene_matters():
    usual = planes_between(FIRST, SECOND, SHARED)
    other = planes_between(
        camera((0.0, 0.0, 0.0), unit=50), camera((0.5, 0.1, 0.1), turn=30, unit=50), 50 * SHARED
    )
    assert usual is not None
    assert other is not None
    assert_close(other.slope, usual.slope / 50)
    for name in ("middle", "still", "moving", "scales"):
        assert_close(getattr(other, name), getattr(usual, name))


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_the_other_photo_shows_the_same_in_the_firsts_frame(turn):
    scene = textured_scene(turn)
    a, b = scene.views[0], scene.views[1]
    pair = pair_of(a.camera, b.camera, a.load(), b.load(), scene.points.positions)
    assert pair is not None
    assert 0.5 < float(pair.covered.double().mean()) < 1
    off = (pair.other - pair.photo).abs().mean(dim=0)
    # bilinear reading of waves of six pixels: 0.03 at most was seen
    assert float(off[pair.covered].quantile(0.99)) < 0.05
    assert float((b.load().permute(2, 0, 1) - pair.photo).abs().mean()) > 0.1  # the control


def test_photos_are_filled_up_to_whole_cells():
    where = replace(FIRST, width=FIRST.width - 3, height=FIRST.height - 1)
    photo = textured_scene().views[0].load()[:-1, :-3]
    pair = pair_of(where, SECOND, photo, textured_scene().views[1].load(), SHARED)
    assert pair is not None
    assert pair.photo.shape == (3, FIRST.height, FIRST.width)
    assert not any(side % STRIDE for side in pair.photo.shape[1:])
    assert torch.equal(pair.photo[:, :-1, :-3], photo.permute(2, 0, 1))
    assert torch.equal(pair.photo[:, :, -1], pair.photo[:, :, -4])


def test_large_photos_are_made_smaller_with_their_cameras(monkeypatch):
    monkeypatch.setattr(plane_sweep, "LONGEST", 32)
    photo = textured_scene().views[0].load()
    small, image = smaller(FIRST, photo)
    assert (small.width, small.height, image.shape) == (32, 24, (24, 32, 3))
    whole, half = (project_points(one, SHARED)[0] for one in (FIRST, small))
    assert_close(half, whole / 2)
    monkeypatch.setattr(plane_sweep, "LONGEST", 64)
    assert smaller(FIRST, photo)[0] is FIRST
