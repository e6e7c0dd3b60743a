import itertools
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.supervision import losses, side_views
from splatproof.reference.supervision.spiral_path import (
    SpiralSettings,
    block_spiral,
    look_at,
    spiral_path,
)
from splatproof.reference.types.camera import Camera, project_points

D = torch.float64
UP = torch.tensor([0.0, 0, 1], dtype=D)
ORIGIN = torch.zeros(3, dtype=D)
settings_of = st.builds(
    SpiralSettings,
    layers=st.integers(1, 5),
    views=st.integers(1, 9),
    radius=st.floats(1, 2),
    look_up=st.floats(0, 0.9),
)


def pinhole(pose: Tensor, width: int = 32, height: int = 24, focal: float = 30.0) -> Camera:
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=height)


def test_look_at_by_hand():
    # From (0, -5, 0) towards +y with z up: right is +x, image down is -z.
    pose = look_at(torch.tensor([0.0, -5, 0], dtype=D), ORIGIN, UP)
    want = torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 5], [0, 0, 0, 1]], dtype=D)
    assert_close(pose, want)


@given(seed=st.integers(0, 2**16))
def test_look_at_puts_the_target_on_the_axis_and_up_upwards(seed):
    eye, target = torch.randn(2, 3, generator=torch.Generator().manual_seed(seed), dtype=D)
    camera = pinhole(look_at(eye, target, UP))
    assert_close(camera.centre, eye, atol=1e-12, rtol=0)
    assert_close(camera.rotation @ camera.rotation.T, torch.eye(3, dtype=D), atol=1e-12, rtol=0)
    assert float(torch.linalg.det(camera.rotation)) == pytest.approx(1)
    pixel, z = project_points(camera, torch.stack([target, target + 0.01 * UP]))
    assert pixel[0].tolist() == pytest.approx([16, 12])
    assert float(z[0]) == pytest.approx(float((target - eye).norm()))
    assert float(pixel[1, 1]) < float(pixel[0, 1])


def test_nadir_has_another_up():
    pose = look_at(5 * UP, ORIGIN, UP)
    assert pose.isfinite().all()
    assert_close(pose[:3, :3] @ pose[:3, :3].T, torch.eye(3, dtype=D))
    with pytest.raises(ValueError, match="coincide"):
        look_at(UP, UP, UP)


@settings(max_examples=40)
@given(options=settings_of, footprint=st.floats(0.1, 100), height=st.floats(0.1, 100))
def test_spiral_descends_above_the_ground_around_the_scene(options, footprint, height):
    centre = torch.tensor([3.0, -2, 7], dtype=D)
    poses = spiral_path(centre, UP, footprint, height, options)
    eyes = torch.stack([pinhole(pose).centre for pose in poses.reshape(-1, 4, 4)])
    eyes = eyes.reshape(options.layers, options.views, 3) - centre
    heights = eyes[..., 2]
    assert (heights > 0).all()
    assert_close(heights[0], torch.full_like(heights[0], height))
    assert (heights[1:, 0] < heights[:-1, 0]).all()
    assert_close(eyes[..., :2].norm(dim=-1), torch.full_like(heights, options.radius * footprint))
    forward = poses[..., 2, :3]
    assert (torch.linalg.cross(forward, UP.expand_as(forward)).norm(dim=-1) > 1e-3).all()


def look_heights(poses: Tensor) -> Tensor:
    """Where each view's axis meets the vertical through the origin."""
    eyes = torch.stack([pinhole(pose).centre for pose in poses.reshape(-1, 4, 4)])
    forward = poses.reshape(-1, 4, 4)[:, 2, :3]
    along = eyes[:, :2].norm(dim=1) / forward[:, :2].norm(dim=1)
    return (eyes + along[:, None] * forward)[:, 2].reshape(poses.shape[:2])


@settings(max_examples=40)
@given(options=settings_of, footprint=st.floats(0.1, 100), height=st.floats(0.1, 100))
def test_look_at_height_grows_from_the_ground_to_its_share_of_the_lowest_orbit(
    options, footprint, height
):
    at = look_heights(spiral_path(ORIGIN, UP, footprint, height, options)) / height
    assert_close(at, at[:, :1].expand_as(at), atol=1e-9, rtol=0)  # one height an orbit
    assert at[0].tolist() == pytest.approx([0] * options.views, abs=1e-9)
    if options.layers > 1:
        lowest = options.look_up / options.layers
        assert at[-1].tolist() == pytest.approx([lowest] * options.views, abs=1e-9)
        assert (at[:, 0].diff() > -1e-9).all()


def test_a_spiral_circles_its_own_block():
    """Inner facades of a city are seen: each block has its orbits, at its own place."""
    low, high = torch.tensor([10.0, 20, 1], dtype=D), torch.tensor([16.0, 28, 9], dtype=D)
    settings = SpiralSettings(layers=2, views=5)
    got = block_spiral(low, high, UP, 40.0, settings)
    ground = torch.tensor([13.0, 24, 1], dtype=D)
    assert_close(got, spiral_path(ground, UP, 5.0, 40.0, settings))  # half of the diagonal 6, 8


@given(seed=st.integers(0, 2**16))
def test_a_block_spiral_turns_with_the_world(seed):
    """Up along any axis, either way: the same orbits around the same box."""
    low, high = torch.tensor([10.0, 20, 1], dtype=D), torch.tensor([16.0, 28, 9], dtype=D)
    g = torch.Generator().manual_seed(seed)
    turn = torch.eye(3, dtype=D)[torch.randperm(3, generator=g)]
    turn = turn * (2 * torch.randint(0, 2, (3, 1), generator=g) - 1)
    corners = torch.stack([turn @ low, turn @ high])
    poses = block_spiral(
        corners.amin(dim=0), corners.amax(dim=0), turn @ UP, 40.0, SpiralSettings()
    )
    eyes = torch.stack([pinhole(pose).centre for pose in poses.reshape(-1, 4, 4)]) @ turn
    around = eyes - torch.tensor([13.0, 24, 1], dtype=D)
    assert_close(around[:, :2].norm(dim=1), torch.full((48,), 5.0, dtype=D))
    heights = around[:, 2].reshape(4, 12)
    assert_close(heights, torch.tensor([40.0, 30, 20, 10], dtype=D)[:, None].expand(4, 12))


def test_neighbouring_orbits_are_turned_by_half_a_step():
    poses = spiral_path(ORIGIN, UP, 10.0, 20.0, SpiralSettings(layers=2, views=6))
    around = torch.stack([torch.stack([pinhole(p).centre[:2] for p in row]) for row in poses]) / 10
    angles = torch.rad2deg(torch.atan2(around[..., 1], around[..., 0])) % 60
    assert_close(angles[0], angles[0, :1].expand(6), atol=1e-9, rtol=0)
    assert float((angles[1, 0] - angles[0, 0]) % 60) == pytest.approx(30, abs=1e-9)


def seen_points(pose: Tensor, points: Tensor) -> Tensor:
    camera = pinhole(pose, 64, 48, focal=40.0)
    pixel, z = project_points(camera, points)
    return (z > 0) & (pixel >= 0).all(dim=1) & (pixel < torch.tensor([64, 48])).all(dim=1)


def test_successive_views_overlap_and_the_top_orbit_sees_the_roofs():
    points = torch.rand(400, 3, generator=torch.Generator().manual_seed(0), dtype=D)
    points = (points - 0.5) * torch.tensor([14.0, 14, 2], dtype=D) + UP
    poses = spiral_path(ORIGIN, UP, 10.0, 20.0, SpiralSettings()).reshape(-1, 4, 4)
    views = [seen_points(pose, points) for pose in poses]
    for a, b in itertools.pairwise(views):
        assert int((a & b).sum()) >= 0.5 * int(a.sum()) > 0
    nadir = seen_points(look_at(20 * UP, ORIGIN, UP), points)
    assert all(int((v & nadir).sum()) > 0.9 * int(nadir.sum()) for v in views[:12])


@pytest.mark.parametrize(
    ("footprint", "height", "views"), [(0.0, 1.0, 3), (1.0, -1.0, 3), (1.0, 1.0, 0)]
)
def test_senseless_spirals_are_refused(footprint, height, views):
    with pytest.raises(ValueError, match="need positive lengths"):
        spiral_path(ORIGIN, UP, footprint, height, SpiralSettings(views=views))


def test_loss_starts_half_way_and_comes_every_nth_step():
    steps = [step for step in range(21) if side_views.is_side_view_step(step, 21, 3)]
    assert steps == [10, 13, 16, 19]


def test_nearest_photo_by_shared_points_then_angle():
    forward = torch.tensor([[0.0, 0, -1], [0.6, 0, -0.8], [1.0, 0, 0]], dtype=D)
    side = torch.tensor([1.0, 0, 0], dtype=D)
    assert side_views.nearest_photo(torch.tensor([5.0, 5, 1], dtype=D), forward, side) == 1
    assert side_views.nearest_photo(torch.tensor([6.0, 5, 1], dtype=D), forward, side) == 0
    with pytest.raises(ValueError, match="no training view"):
        side_views.nearest_photo(torch.zeros(0, dtype=D), forward[:0], side)


def images(seed: int) -> tuple[Tensor, Tensor]:
    a, b = torch.rand(2, 14, 15, 3, generator=torch.Generator().manual_seed(seed), dtype=D)
    return a, b


def test_loss_where_nothing_is_proven_is_the_photometric_loss():
    a, b = images(0)
    nothing = torch.zeros(14, 15, dtype=D)
    want = 0.8 * (a - b).abs().mean() + 0.2 * (1 - losses.ssim_map(a, b).mean())
    assert_close(side_views.side_loss(a, b, nothing, nothing), want)


def test_real_evidence_wins():
    a, b = images(1)
    alpha, seen = torch.full((14, 15), 0.95, dtype=D), torch.full((14, 15), 2.0, dtype=D)
    assert float(side_views.side_loss(a, b, alpha, seen)) == 0
    seen[3, 4] = 1.0
    assert float(side_views.side_loss(a, b, alpha, seen)) > 0
    a.requires_grad_()
    side_views.side_loss(a, b, alpha, seen).backward()
    assert a.grad is not None
    changed = a.grad.abs().sum(dim=-1) > 0
    assert changed.nonzero().tolist() == [[3, 4]]


def test_refined_image_gets_no_gradient():
    a, b = (x.requires_grad_() for x in images(2))
    nothing = torch.zeros(14, 15, dtype=D)
    side_views.side_loss(a, b, nothing, nothing).backward()
    assert b.grad is None


def seen_view(camera: Camera, image: Tensor, depth: Tensor, alpha: float = 1.0):
    return side_views.SeenView(
        camera=camera, image=image, depth=depth, alpha=torch.full_like(depth, alpha)
    )


def plane_views():
    """A textured ground plane from above and from the side, with exact depths and colours."""

    def colour(points: Tensor) -> Tensor:
        x, y = points[:, 0], points[:, 1]
        return torch.stack([0.5 + 0.4 * x.sin(), 0.5 + 0.4 * y.cos(), 0.5 + 0 * x], dim=1)

    def view(eye: list[float]):
        camera = pinhole(look_at(torch.tensor(eye, dtype=D), ORIGIN, UP))
        far = side_views.unproject(camera, torch.ones(24, 32, dtype=D))
        ray = far - camera.centre
        depth = -camera.centre[2] / ray[:, 2]
        image = colour(camera.centre + depth[:, None] * ray).reshape(24, 32, 3)
        return seen_view(camera, image, depth.reshape(24, 32))

    return view([0.0, 0.001, 9.0]), view([2.0, -3.0, 6.0])


GREY = torch.full((24, 32, 3), 0.2, dtype=D)


def in_photo(top: side_views.SeenView, side: side_views.SeenView, margin: float = 0) -> Tensor:
    """Pixels of the side view that land in the photo, that far from its border."""
    at, _ = project_points(top.camera, side_views.unproject(side.camera, side.depth))
    size = torch.tensor([32, 24])
    inside = (at >= margin).all(dim=1) & (at < size - margin).all(dim=1)
    return inside.reshape(24, 32)


def test_warp_brings_the_texture_of_the_photo_to_the_side_view():
    top, side = plane_views()
    got = side_views.warp_and_fill(replace(side, image=GREY), top)
    warped = (got - 0.2).abs().sum(dim=-1) > 1e-6
    assert int(warped.sum()) > 300
    inner = warped & in_photo(top, side, 0.5)
    # Bilinear reading of a texture with curvature 0.4 at 0.3 units a pixel: 0.4 * 0.3^2 / 8.
    assert float((got - side.image)[inner].abs().max()) < 0.0045 * 1.05


def test_occluded_texture_is_not_taken():
    top, side = plane_views()
    nearer = replace(top, depth=top.depth * 0.9)  # something stands in front of the plane
    side = replace(side, image=GREY)
    assert_close(side_views.warp_and_fill(side, nearer), side.image)


def test_haze_is_a_hole():
    """Opacity 0.02 gives a pixel a depth, but it shows nothing: it is filled, not warped to."""
    top, side = plane_views()
    hazy = torch.zeros(24, 32, dtype=torch.bool)
    hazy[10:13, 14:17] = True
    alpha = torch.where(hazy, 0.02, side.alpha)
    dark = replace(side, alpha=alpha, image=torch.where(hazy[..., None], 0.0, side.image))
    nothing = replace(top, alpha=0 * top.alpha)  # so that only filling can change a pixel
    got = side_views.warp_and_fill(dark, nothing)
    assert_close(got[~hazy], side.image[~hazy])
    assert float((got - side.image)[hazy].abs().max()) < 0.1
    assert float(got[hazy].min()) > 0.1
    warped = side_views.warp_and_fill(dark, top)  # a photo that sees it has no depth to go by
    assert_close(warped[hazy], got[hazy], atol=0.05, rtol=0)
    assert not side_views.sees(top, dark)[hazy].any()


def test_views_are_counted_that_see_the_surface():
    top, side = plane_views()
    training = [
        top,
        replace(top, depth=top.depth * 0.9),  # something stands in front of the plane
        replace(top, depth=top.depth * 1.1),  # its model has nothing where the side view has
        replace(top, alpha=0.3 * top.alpha),  # haze
        replace(top, camera=pinhole(look_at(9 * UP, 20 * UP, UP))),  # looks away
        side,  # itself
    ]
    inside = in_photo(top, side).double()
    assert 100 < int(inside.sum()) < 700
    assert_close(side_views.seen_by(side, training), 1 + inside)
    assert float(side_views.seen_by(replace(side, alpha=0.4 * side.alpha), training).max()) == 0
    assert_close(side_views.seen_by(side, []), torch.zeros(24, 32, dtype=D))


def test_holes_are_filled_from_around_and_the_rest_is_untouched():
    image = torch.rand(12, 12, 3, generator=torch.Generator().manual_seed(0), dtype=D) * 0.1 + 0.6
    holes = torch.zeros(12, 12, dtype=torch.bool)
    holes[5:7, 5:7] = True
    broken = torch.where(holes[..., None], 0.0, image)
    got = side_views.fill_holes(broken, holes)
    assert_close(got[~holes], image[~holes])
    assert float((got[holes] - 0.65).abs().max()) < 0.1
