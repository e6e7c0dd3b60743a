"""Disparity by matching photos: geometry in closed form, agreement, scale, and a made world."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.datasets.image_cache import ImageCache
from splatproof.methods.priors import sweep
from splatproof.methods.priors.alignment import aligned, in_scale
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import DepthPrior, Scene, SparsePoints, View

FIRST, SECOND = camera(0, width=96, height=72), camera(2, width=96, height=72)


def textured(where, depth: float = 5.0) -> torch.Tensor:
    """What a camera sees of the plane z = depth - 4, painted with waves."""
    points = on_plane(where, depth)
    x, y = points[..., 0], points[..., 1]
    waves = [torch.sin(k * (a * x + b * y) + c) for k, a, b, c in
             ((9, 1, 0.3, 0), (14, -0.4, 1, 1), (23, 1, 1, 2), (31, 0.8, -1, 3))]  # fmt: skip
    level = (0.5 + 0.11 * torch.stack(waves).sum(dim=0)).float().clamp(0, 1)
    return level[..., None].expand(*level.shape, 3).contiguous()


def on_plane(where, depth: float) -> torch.Tensor:
    """World points of a camera's pixels at z-depth `depth`; all cameras here look along z."""
    row, column = torch.meshgrid(
        torch.arange(where.height) + 0.5, torch.arange(where.width) + 0.5, indexing="ij"
    )
    pixel = torch.stack([column, row, torch.ones_like(row)], dim=-1).double()
    return depth * (pixel @ torch.linalg.inv(where.K).T) - where.translation


def scene(**changes) -> Scene:
    """Three views of a painted plane at z-depth 5, whose SfM points lie on it."""
    positions = on_plane(FIRST, 5.0)[10:60:8, 30:90:8].reshape(-1, 3)
    count = len(positions)
    points = SparsePoints(
        positions=positions, colours=torch.zeros(count, 3, dtype=torch.uint8),
        track_starts=3 * torch.arange(count + 1), track_views=torch.arange(3).repeat(count),
    )  # fmt: skip
    views = tuple(
        View(name=f"{i}.png", camera=where, load=lambda where=where: textured(where))
        for i, where in enumerate((FIRST, SECOND, camera(1, width=96, height=72)))
    )
    made = replace(tiny_scene(), views=views, train=(0, 1, 2), test=(), points=points)
    return replace(made, **changes)


def test_a_match_says_the_disparity_at_which_the_ray_meets_it():
    """By projection of known points, not by the formula under test."""
    depth = 3 + torch.rand(72, 96, generator=torch.Generator().manual_seed(0)).double() * 4
    row, column = torch.meshgrid(torch.arange(72) + 0.5, torch.arange(96) + 0.5, indexing="ij")
    pixel = torch.stack([column, row], dim=-1).double()
    world = on_plane(FIRST, 1.0) + FIRST.translation
    there, _ = project_points(SECOND, (depth[..., None] * world - FIRST.translation).reshape(-1, 3))
    warp = there.reshape(72, 96, 2) - pixel
    disparity, off, slope = sweep.along_ray(FIRST, SECOND, warp)
    assert_close(disparity, 1 / depth)
    assert float(off.max()) < 1e-6
    # across the epipolar line the match is off by as much as it was moved
    across = (SECOND.centre - FIRST.centre)[:2].flip(0) * torch.tensor([-1.0, 1.0])
    moved = sweep.along_ray(FIRST, SECOND, warp + 2 * across / across.norm())
    assert_close(moved[0], disparity)
    assert_close(moved[1], torch.full((72, 96), 2.0, dtype=torch.float64))
    closer, _ = project_points(
        SECOND, ((1 / (1 / depth + 1e-5))[..., None] * world - FIRST.translation).reshape(-1, 3)
    )
    assert_close((closer - there).norm(dim=1).reshape(72, 96) / 1e-5, slope, rtol=1e-3, atol=0)


def test_a_painted_plane_comes_out_where_it_is():
    make = sweep.prepare(scene(), None, 0)
    prior = make(0)
    assert float(prior.valid.float().mean()) > 0.4
    assert_close(prior.disparity[prior.valid].median(), torch.tensor(0.2), rtol=0.01, atol=0)
    assert (prior.disparity[~prior.valid] == 0).all()


def test_masked_pixels_are_not_valid():
    made = scene()
    mask = torch.ones(72, 96, dtype=torch.bool)
    mask[:, 50:] = False
    views = (replace(made.views[0], load_mask=mask.clone), *made.views[1:])
    prior = sweep.prepare(replace(made, views=views), None, 0)(0)
    assert prior.valid[:, :50].any()
    assert not prior.valid[:, 50:].any()


def test_only_what_two_neighbours_say_is_valid_and_most_win():
    view = replace(scene().views[0], camera=camera(0, width=4, height=1))
    sure = torch.ones(1, 4)
    found = [
        (torch.tensor([[0.20, 0.20, 0.20, 0.20]]), sure),
        (torch.tensor([[0.201, 0.40, 0.201, 0.3]]), sure),
        (torch.tensor([[0.40, 0.40, 0.199, 0.2]]), torch.tensor([[9.0, 1.0, 2.0, 0.0]])),
    ]
    prior = sweep.agreed(found, view)
    assert prior.valid.tolist() == [[True, True, True, False]]
    assert_close(prior.disparity, torch.tensor([[0.2005, 0.4, 0.19975, 0.0]]))
    assert not sweep.agreed([], view).valid.any()
    assert not sweep.agreed(found[:1], view).valid.any()


def test_the_better_confirmed_of_two_disparities_wins_in_any_order():
    view = replace(scene().views[0], camera=camera(0, width=1, height=1))
    pairs = [(torch.tensor([[d]]), torch.tensor([[w]])) for d, w in
             ((0.2, 5.0), (0.2, 5.0), (0.4, 1.0), (0.4, 1.0))]  # fmt: skip
    for found in (pairs, pairs[::-1]):
        assert_close(sweep.agreed(found, view).disparity, torch.tensor([[0.2]]))


def test_scale_and_zero_are_those_of_the_points_though_some_are_wrong():
    positions = on_plane(FIRST, 5.0)[::6, ::6].reshape(-1, 3)
    positions[:, 2] += torch.linspace(0, 2, len(positions))
    at, z = project_points(FIRST, positions)
    column, row = at.floor().long().T
    inside = (column >= 0) & (column < 96) & (row >= 0) & (row < 72)
    wrong = torch.zeros(72, 96)
    wrong[row[inside], column[inside]] = ((1 / z[inside] - 0.02) / 1.5).float()
    prior = DepthPrior(disparity=wrong, valid=wrong > 0)
    spoilt = positions.clone()
    spoilt[::4, 2] += 3
    moved = in_scale(prior, FIRST, spoilt)
    good = torch.arange(len(positions))[inside] % 4 != 0
    want = 1 / z[inside][good]
    found = moved.disparity[row[inside][good], column[inside][good]].double()
    assert float(((found - want).abs() / want).median()) < 0.01
    few = in_scale(prior, FIRST, positions[:5])
    assert few is prior


def test_alignment_does_not_heed_a_minority():
    x = torch.linspace(0.1, 1, 40)
    t = 0.7 * x + 0.05
    t[::3] *= 3
    fit = aligned(x, t)
    assert fit is not None
    assert_close(torch.tensor(fit), torch.tensor([0.7, 0.05]), rtol=0.01, atol=1e-3)
    assert aligned(torch.ones(9), t[:9]) is None
    assert aligned(x[:1], t[:1]) is None


def test_points_without_tracks_choose_nobody():
    with pytest.raises(
        UsageError, match="tiny: no two training views share sparse points.*'lidar'"
    ):
        sweep.prepare(tiny_scene(), None, 0)


def test_photos_of_two_sizes_without_a_plane_are_not_matched():
    made = scene()
    other = replace(made.views[1], load=lambda: torch.zeros(30, 40, 3))
    nothing = torch.zeros(0, 3, dtype=torch.float64)
    _, weight = sweep.matched(made.views[0], other, nothing, ImageCache(0))
    assert not weight.any()
