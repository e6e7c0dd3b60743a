from dataclasses import replace
from fractions import Fraction

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.reference.rasterizer import projection, rotation
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera, project_points, transform_points

D = torch.float64


def camera(seed: int = 0, width: int = 40, height: int = 30) -> Camera:
    """A camera somewhere, with its principal point off the middle."""
    generator = torch.Generator().manual_seed(seed)
    pose = torch.eye(4, dtype=D)
    pose[:3, :3] = rotation.rotation_matrix(torch.randn(1, 4, generator=generator, dtype=D))[0]
    pose[:3, 3] = torch.randn(3, generator=generator, dtype=D)
    intrinsics = torch.tensor([[50.0, 0, 17.0], [0, 45.0, 16.0], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=height)


def in_view(view: Camera, n: int, seed: int) -> torch.Tensor:
    """World points that project into the image at depths 2 to 6."""
    generator = torch.Generator().manual_seed(seed)
    share = torch.rand(n, 2, generator=generator, dtype=D)
    pixel = share * torch.tensor([view.width, view.height])
    z = 2 + 4 * torch.rand(n, 1, generator=generator, dtype=D)
    ray = torch.cat([pixel, torch.ones(n, 1, dtype=D)], dim=1) @ torch.linalg.inv(view.K).T
    return (ray * z - view.translation) @ view.rotation


def test_camera_centre_is_where_camera_space_is_zero():
    view = camera(3)
    assert_close(transform_points(view, view.centre[None])[0], torch.zeros(3, dtype=D))


def test_projection_by_hand():
    # x_cam = (1, -0.5, 2): pixel (50 * 0.5 + 17, 45 * -0.25 + 16)
    view = Camera(
        K=camera().K, world_to_camera=torch.eye(4, dtype=D), width=40, height=30
    )  # fmt: skip
    pixel, z = project_points(view, torch.tensor([[1.0, -0.5, 2.0]], dtype=D))
    assert_close(pixel[0], torch.tensor([42.0, 4.75], dtype=D))
    assert float(z) == 2.0


@given(n=st.integers(0, 6), seed=st.integers(0, 2**16))
def test_jacobian_is_the_derivative_of_the_projection(n, seed):
    view = camera(seed)
    points = in_view(view, n, seed)
    cam = transform_points(view, points)
    upright = Camera(
        K=view.K, world_to_camera=torch.eye(4, dtype=D), width=view.width, height=view.height
    )
    for i in range(n):
        want = torch.autograd.functional.jacobian(
            lambda p: project_points(upright, p[None])[0][0], cam[i]
        )
        assert_close(projection.jacobian(view, cam)[i], want, atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize(("x", "edge"), [(1e6, 1.15), (-1e6, -0.15)])
def test_direction_is_clamped_inside_the_jacobian_only(x, edge):
    view = camera()
    cam = torch.tensor([[x, 0.0, 2.0]], dtype=D, requires_grad=True)
    limit = (edge * view.width - 17.0) / 50.0
    jacobian = projection.jacobian(view, cam)
    assert_close(jacobian[0, 0, 2], torch.tensor(-50.0 * limit / 2.0, dtype=D))
    jacobian[0, 0, 2].backward()
    assert cam.grad is not None
    assert float(cam.grad[0, 0]) == 0


def test_with_the_principal_point_in_the_middle_the_clamp_is_the_releases():
    view = camera()
    K = view.K.clone()
    K[0, 2], K[1, 2] = view.width / 2, view.height / 2
    cam = torch.tensor([[1e6, 1e6, 2.0], [-1e6, -1e6, 2.0]], dtype=D)
    got = projection.jacobian(replace(view, K=K), cam)[:, :, 2] * -2
    want = 1.3 * 0.5 * torch.tensor([view.width, view.height], dtype=D)
    assert_close(got, torch.stack([want, -want]))


@given(seed=st.integers(0, 2**16), left=st.integers(0, 35), top=st.integers(0, 25))
def test_a_cropped_photo_shows_what_the_whole_shows(seed, left, top):
    view = camera(seed)
    K = view.K.clone()
    K[0, 2] -= left
    K[1, 2] -= top
    part = replace(view, K=K, width=view.width - left, height=view.height - top)
    cam = transform_points(part, in_view(part, 6, seed))
    assert_close(projection.jacobian(part, cam), projection.jacobian(view, cam), atol=0, rtol=0)


@given(n=st.integers(0, 6), seed=st.integers(0, 2**16))
def test_small_gaussians_project_to_the_spread_of_their_samples(n, seed):
    view = camera(seed)
    generator = torch.Generator().manual_seed(seed)
    means = in_view(view, n, seed)
    quaternions = torch.randn(n, 4, generator=generator, dtype=D)
    scales = 1e-4 * (0.5 + torch.rand(n, 3, generator=generator, dtype=D))
    sigma = rotation.covariance(quaternions, scales)
    flat = projection.project(view, means, rotation.half_covariance(quaternions, scales))
    noise = torch.randn(20000, 3, generator=generator, dtype=D)
    for i in range(n):
        samples = means[i] + noise @ torch.linalg.cholesky(sigma[i]).T
        spread = torch.cov(project_points(view, samples)[0].T)
        got = flat.covariances[i] - projection.BLUR * torch.eye(2, dtype=D)
        # 20,000 samples: relative standard error of a variance is sqrt(2 / 20000) = 1 %.
        assert_close(got, spread, atol=0.06 * float(spread.diagonal().max()), rtol=0)


def test_behind_the_near_plane_is_not_drawn_and_stays_finite():
    view = Camera(K=camera().K, world_to_camera=torch.eye(4, dtype=D), width=40, height=30)
    means = torch.tensor([[0.0, 0, 0.01], [0, 0, 0.0100001], [0, 0, -1], [0, 0, 0]], dtype=D)
    means.requires_grad_()
    flat = projection.project(view, means, 0.1 * torch.eye(3, dtype=D).expand(4, 3, 3))
    assert flat.in_front.tolist() == [False, True, False, False]
    (flat.means.sum() + flat.covariances.sum() + flat.compensation.sum()).backward()
    assert means.grad is not None
    assert means.grad.isfinite().all()
    assert not means.grad[2:].any()


@given(n=st.integers(1, 6), seed=st.integers(0, 2**16), opacity=st.floats(0.005, 1))
def test_support_box_bounds_the_ellipse_and_touches_it(n, seed, opacity):
    view = camera(seed)
    halves = rotation.half_covariance(
        torch.randn(n, 4, generator=torch.Generator().manual_seed(seed), dtype=D),
        torch.full((n, 3), 0.1, dtype=D) * torch.tensor([1.0, 0.5, 2.0]),
    )
    flat = projection.project(view, in_view(view, n, seed), halves)
    opacities = torch.full((n,), opacity, dtype=D)
    half = projection.support_box(flat, opacities)
    angle = torch.linspace(0, 2 * torch.pi, 2001, dtype=D)
    circle = torch.stack([angle.cos(), angle.sin()], dim=1)
    reach = (2 * torch.log(opacities * 255)).clamp(min=0).sqrt()
    edge = circle @ torch.linalg.cholesky(flat.covariances).mT * reach[:, None, None]
    assert_close(edge.abs().amax(dim=1), half, atol=1e-9, rtol=1e-5)


@pytest.mark.parametrize(("mean", "seen"), [([0.0, 0, 2], True), ([50.0, 0, 2], False)])
def test_radii_are_zero_where_nothing_can_be_seen(mean, seen):
    view = Camera(K=camera().K, world_to_camera=torch.eye(4, dtype=D), width=40, height=30)
    flat = projection.project(
        view, torch.tensor([mean], dtype=D), 0.1 * torch.eye(3, dtype=D)[None]
    )
    assert (float(projection.screen_radii(view, flat, torch.ones(1, dtype=D))) > 0) is seen
    faint = torch.full((1,), 1 / 256, dtype=D)
    assert float(projection.screen_radii(view, flat, faint)) == 0


def test_compensation_keeps_its_digits_for_a_needle():
    """Scale ratio 1e4 : 1 in float32: the textbook determinant would lose every digit."""
    view = camera()
    means = in_view(view, 20, 5)
    scales = torch.tensor([[1.0, 1e-4, 1e-4]], dtype=D).expand(20, 3)
    turn = torch.randn(20, 4, generator=torch.Generator().manual_seed(1), dtype=D)
    halves = rotation.half_covariance(turn, scales)
    exact = projection.project(view, means, halves).compensation
    sharp = projection.project(view, means, halves)
    want = (
        torch.linalg.det(sharp.covariances - 0.3 * torch.eye(2, dtype=D))
        / torch.linalg.det(sharp.covariances)
    ).sqrt()
    assert_close(exact, want, atol=1e-6, rtol=1e-4)
    rough = projection.project(
        view.to(torch.float32),
        means.float(),
        rotation.half_covariance(turn.float(), scales.float()),
    )
    assert_close(rough.compensation.double(), exact, atol=1e-6, rtol=1e-3)


@pytest.mark.parametrize("length", [1.0, 1e4, 1e8, 1e14, 1e20, 1e30])
def test_the_inverse_of_a_needle_keeps_its_digits(length):
    """Against whole numbers' arithmetic; torch.linalg.inv is off by more than 1 from 1e8 on."""
    view = camera(2)
    generator = torch.Generator().manual_seed(int(length) % 2**31)
    n = 20
    scales = torch.full((n, 3), 0.1, dtype=D)
    scales[torch.arange(n), torch.arange(n) % 3] = length
    halves = rotation.half_covariance(torch.randn(n, 4, generator=generator, dtype=D), scales)
    means = in_view(view, n, 5)
    flat = projection.project(view, means, halves)
    factors = (
        projection.jacobian(view, transform_points(view, means)) @ view.rotation.to(D) @ halves
    )
    blur = Fraction(projection.BLUR)
    for i in range(n):
        first, second = ([Fraction(v) for v in row] for row in factors[i].tolist())
        a, b, c = (
            sum(x * y for x, y in zip(p, q, strict=True))
            for p, q in ((first, first), (first, second), (second, second))
        )
        a, c = a + blur, c + blur
        det = a * c - b * b
        want = [[c / det, -b / det], [-b / det, a / det]]
        scale = float(max(abs(v) for row in want for v in row))
        got = flat.conics[i].tolist()
        for row, exact in zip(got, want, strict=True):
            for value, true in zip(row, exact, strict=True):
                # products of three rounded numbers, their sums, a quotient
                assert abs(value - float(true)) <= 16 * torch.finfo(D).eps * scale


@pytest.mark.parametrize("length", [1e8, 1e20])
def test_an_endless_needle_is_a_line(length):
    """Its picture, and its gradients but for its length's, are those of one that is long enough."""
    view = camera(2)
    means = in_view(view, 1, 5)

    def seen(size: float) -> tuple[torch.Tensor, ...]:
        tip = torch.tensor([[size, 0.1, 0.1]], dtype=D)
        inputs = [means.clone().requires_grad_(), torch.tensor([[0.3, 0.5, -0.2, 0.7]], dtype=D),
                  tip, torch.tensor([0.8], dtype=D).requires_grad_()]  # fmt: skip
        colours = torch.ones(1, 3, dtype=D)
        drawn = rasterize(view, *inputs, colours=colours).colour
        drawn.sum().backward()
        assert inputs[0].grad is not None
        assert inputs[3].grad is not None
        return drawn.detach(), inputs[0].grad, inputs[3].grad

    for got, want in zip(seen(length), seen(1e5), strict=True):
        # the longer one's density falls along the image by (100 px / 1e6 px)^2
        assert_close(got, want, atol=1e-6, rtol=1e-6)
