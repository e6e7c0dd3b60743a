"""Depth that is known before training: the truth, or what the sparse points say."""

from dataclasses import replace

import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints
from splatproof.suites.scene_scores.surface import surface_depth


def scene_of(positions: torch.Tensor, seen_by: int | None) -> Scene:
    """The tiny scene with these points, all of them observed by one view, or by none."""
    count = len(positions)
    rows = 0 if seen_by is None else 1
    points = SparsePoints(
        positions=positions,
        colours=torch.zeros(count, 3, dtype=torch.uint8),
        track_starts=torch.arange(count + 1) * rows,
        track_views=torch.full((count * rows,), seen_by or 0),
    )
    return replace(tiny_scene(), points=points)


def plane(count: int = 400) -> torch.Tensor:
    """Points of z = 0.3 x - 0.2 y, more than the image shows."""
    generator = torch.Generator().manual_seed(1)
    xy = torch.rand(count, 2, generator=generator, dtype=torch.float64) * 8 - 4
    return torch.cat([xy, (0.3 * xy[:, :1] - 0.2 * xy[:, 1:])], dim=1)


def inner(depth: torch.Tensor) -> torch.Tensor:
    return depth[6:-6, 6:-6]


def plane_depth(index: int) -> torch.Tensor:
    """z along each pixel's ray to the plane, solved for directly."""
    view = camera(index)
    y, x = torch.meshgrid(torch.arange(18) + 0.5, torch.arange(24) + 0.5, indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)], dim=2).double() @ torch.linalg.inv(view.K).T
    normal = torch.tensor([0.3, -0.2, -1.0], dtype=torch.float64)
    return -(view.centre @ normal) / (rays @ view.rotation @ normal)


def test_between_points_of_a_plane_depth_is_exact():
    for seen_by in (2, None):  # observed, or too few observed: all points in the image
        depth = surface_depth(scene_of(plane(), seen_by), 2)
        assert depth.shape == (18, 24)
        error = (inner(depth) - inner(plane_depth(2))).abs().max()
        assert error < 1e-5  # float32 of depths near 4


def test_points_that_the_view_does_not_observe_do_not_count():
    floor, roof = plane(), torch.tensor([[0.0, 0.0, -2.0]], dtype=torch.float64)
    both = scene_of(torch.cat([floor, roof]), 2)
    starts = both.points.track_starts.clone()
    starts[-1] -= 1  # the roof point, last, is observed by nobody
    hidden = replace(both.points, track_starts=starts, track_views=both.points.track_views[:-1])
    pixel, _ = project_points(camera(2), roof)
    x, y = pixel[0].int().tolist()
    truth = plane_depth(2)[y, x]
    assert abs(surface_depth(replace(both, points=hidden), 2)[y, x] - truth) < 1e-4
    assert abs(surface_depth(both, 2)[y, x] - truth) > 0.1  # the control


def test_few_points_give_the_nearest_ones_depth_and_none_gives_inf():
    one = surface_depth(scene_of(torch.zeros(1, 3, dtype=torch.float64), 2), 2)
    assert (one - 4).abs().max() < 1e-6
    behind = surface_depth(scene_of(torch.tensor([[0.0, 0.0, -9.0]]).double(), 2), 2)
    assert behind.isinf().all()


def test_truth_goes_first():
    scene = scene_of(plane(), 2)
    views = list(scene.views)
    views[2] = replace(views[2], load_depth=lambda: torch.full((18, 24), 7.0))
    assert (surface_depth(replace(scene, views=tuple(views)), 2) == 7).all()
