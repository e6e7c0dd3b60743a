"""Sideways views: moved as far as asked, warped back exactly, without a gradient where nothing is seen."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.supervision.sideways_view import (
    inverse_depth_loss,
    sideways,
    sideways_loss,
    warped_back,
)
from splatproof.reference.types.camera import Camera, project_points

D = torch.float64
WIDTH, HEIGHT = 20, 12
SEEDS = st.integers(0, 2**16)


def camera_of(seed: int) -> Camera:
    """A camera that looks anywhere from anywhere."""
    generator = torch.Generator().manual_seed(seed)
    pose = torch.eye(4, dtype=D)
    pose[:3, :3] = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=D)).Q
    pose[:3, :3] *= torch.linalg.det(pose[:3, :3])
    pose[:3, 3] = 5 * torch.randn(3, generator=generator, dtype=D)
    intrinsics = torch.tensor([[15.0, 0, WIDTH / 2], [0, 15, HEIGHT / 2], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=WIDTH, height=HEIGHT, near=0.01)


def picture(seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(HEIGHT, WIDTH, 3, generator=generator, dtype=D)


def flat(depth: float) -> Tensor:
    return torch.full((HEIGHT, WIDTH), depth, dtype=D)


@given(SEEDS, st.floats(-0.3, 0.3), st.floats(0.5, 50))
def test_what_lies_at_the_depth_shifts_by_the_share(seed, share, depth):
    camera = camera_of(seed)
    beside = sideways(camera, torch.tensor(depth, dtype=D), share)
    before, _ = project_points(camera, unproject(camera, flat(depth)))
    after, z = project_points(beside, unproject(camera, flat(depth)))
    assert_close(after - before, torch.tensor([-share * WIDTH, 0.0], dtype=D).expand(len(after), 2))
    assert_close(z, flat(depth).reshape(-1))
    assert_close(beside.rotation, camera.rotation)


@given(SEEDS, st.floats(0.5, 50))
def test_without_a_shift_the_image_comes_back_exactly(seed, depth):
    camera, image = camera_of(seed), picture(seed)
    beside = sideways(camera, torch.tensor(depth, dtype=D), 0.0)
    depths = flat(depth) * (1 + picture(seed + 1)[..., 0])
    back, there = warped_back(image, beside, camera, depths)
    assert bool(there.all())
    assert_close(back, image)
    loss = sideways_loss(image, beside, image, camera, depths, there)
    assert float(loss) == pytest.approx(0, abs=1e-9)


@given(SEEDS, st.integers(1, 6), st.floats(0.5, 50))
def test_a_plane_comes_back_by_whole_pixels(seed, pixels, depth):
    camera, image = camera_of(seed), picture(seed)
    beside = sideways(camera, torch.tensor(depth, dtype=D), pixels / WIDTH)
    back, there = warped_back(image, beside, camera, flat(depth))
    # What the photo has at column x is at x - pixels from beside; further left it is out of the image.
    assert_close(back[:, pixels + 1 :], image[:, 1:-pixels])
    assert bool(there[:, pixels + 1 :].all())
    assert not bool(there[:, : pixels - 1].any())


def test_only_what_is_seen_from_beside_is_compared():
    camera, image = camera_of(0), picture(0)
    beside = sideways(camera, torch.tensor(2.0, dtype=D), 0.2)
    back, there = warped_back(image, beside, camera, flat(2.0))
    assert 0 < int(there.sum()) < there.numel()
    every = torch.ones_like(there)
    photo = torch.where(there[..., None], back, 9.0)
    assert float(sideways_loss(image, beside, photo, camera, flat(2.0), every)) == 0
    photo = torch.where(there[..., None], back + 0.25, 9.0)
    loss = sideways_loss(image, beside, photo, camera, flat(2.0), every)
    assert float(loss) == pytest.approx(0.25)


def test_what_has_no_depth_is_not_at_the_camera_s_centre():
    camera = camera_of(0)
    behind = camera.world_to_camera.clone()
    behind[2, 3] += 3.0  # the camera of the photo stands ahead of it
    depths = flat(2.0)
    depths[3] = 0
    _, there = warped_back(picture(0), replace(camera, world_to_camera=behind), camera, depths)
    assert bool(there[4].all())
    assert not bool(there[3].any())


@given(SEEDS)
def test_surfaces_behind_the_other_camera_or_without_depth_do_not_count(seed):
    camera, image = camera_of(seed), picture(seed)
    depths = flat(2.0)
    depths[3] = 0
    beside = sideways(camera, torch.tensor(2.0, dtype=D))
    _, there = warped_back(image, beside, camera, depths)
    assert not bool(there[3].any())
    turned = beside.world_to_camera.clone()
    turned[[0, 2]] *= -1  # looks the other way
    _, there = warped_back(image, replace(beside, world_to_camera=turned), camera, depths)
    assert not bool(there.any())
    nothing = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    assert float(sideways_loss(image, beside, image + 1, camera, depths, nothing)) == 0


def test_gradients_reach_image_and_depth_and_are_finite_without_depth():
    camera, image = camera_of(0), picture(0).requires_grad_()
    depths = flat(2.0) + 0.1 * picture(2)[..., 0]
    depths[0] = 0
    depths.requires_grad_()
    beside = sideways(camera, depths.median(), 0.1)
    counts = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    sideways_loss(image, beside, picture(1), camera, depths, counts).backward()
    assert image.grad is not None
    assert depths.grad is not None
    assert bool(image.grad.isfinite().all())
    assert bool(depths.grad.isfinite().all())
    assert float(image.grad.abs().sum()) > 0
    assert float(depths.grad.abs().sum()) > 0
    assert not bool(depths.grad[0].any())


def test_a_surface_in_the_plane_of_the_other_camera_has_no_gradient():
    pose = torch.eye(4, dtype=D)
    intrinsics = torch.tensor([[15.0, 0, WIDTH / 2], [0, 15, HEIGHT / 2], [0, 0, 1]], dtype=D)
    camera = Camera(K=intrinsics, world_to_camera=pose, width=WIDTH, height=HEIGHT, near=0.01)
    further = pose.clone()
    further[2, 3] = -2.0  # stands where the surface is
    depths = flat(2.0).requires_grad_()
    beside = replace(camera, world_to_camera=further)
    counts = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    (slope,) = torch.autograd.grad(
        sideways_loss(picture(0), beside, picture(1), camera, depths, counts), depths
    )
    assert not bool(slope.any())


@settings(max_examples=20)
@given(SEEDS)
def test_the_gradient_by_depth_is_that_of_differences(seed):
    camera, image, photo = camera_of(seed), picture(seed), picture(seed + 1)
    counts = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    beside = sideways(camera, torch.tensor(2.0, dtype=D), 0.013)

    def loss(depth: Tensor) -> Tensor:
        return sideways_loss(image, beside, photo, camera, flat(2.0) * depth, counts)

    depth = torch.tensor(1.0, dtype=D, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(depth), depth)
    step = 1e-7
    numeric = (loss(depth.detach() + step) - loss(depth.detach() - step)) / (2 * step)
    assert_close(slope, numeric, rtol=1e-3, atol=1e-5)


@given(SEEDS, st.floats(0.01, 100))
def test_inverse_depth_knows_no_unit_and_counts_what_counts(seed, unit):
    depth, prior = 1 + picture(seed)[..., 0], 1 / (1 + picture(seed + 1)[..., 0])
    counts = picture(seed + 2)[..., 0] > 0.5
    loss = inverse_depth_loss(depth, prior, counts)
    want = (1 / depth - prior).abs()[counts].mean() / prior[counts].median()
    assert_close(loss, want)
    assert_close(inverse_depth_loss(depth * unit, prior / unit, counts), loss)
    assert float(inverse_depth_loss(depth, 1 / depth, counts)) == pytest.approx(0, abs=1e-12)


def test_inverse_depth_without_a_pixel_that_counts_is_nothing():
    depth = flat(1.0).requires_grad_()
    every = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    assert float(inverse_depth_loss(depth, flat(1.0), ~every)) == 0
    assert float(inverse_depth_loss(depth, flat(-1.0), every)) == 0
