"""The dense rasterizer against a scalar loop written from the contract, and its invariants."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.rasterizer import rotation
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.camera import Camera

D = torch.float64


def view(width: int = 9, height: int = 7) -> Camera:
    pose = torch.eye(4, dtype=D)
    pose[:3, :3] = rotation.rotation_matrix(torch.tensor([[0.9, 0.1, -0.2, 0.3]], dtype=D))[0]
    pose[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    intrinsics = torch.tensor([[12.0, 0, 4.0], [0, 11.0, 4.1], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=height)


def scene(n: int, seed: int, camera: Camera) -> dict[str, Any]:
    """Gaussians in front of the camera, some of them nearly opaque."""
    g = torch.Generator().manual_seed(seed)
    cam = torch.randn(n, 3, generator=g, dtype=D) * torch.tensor([0.8, 0.6, 0.5])
    cam[:, 2] = cam[:, 2].abs() + 1
    return {
        "means": (cam - camera.translation) @ camera.rotation,
        "quaternions": torch.randn(n, 4, generator=g, dtype=D),
        "scales": 0.05 + 0.4 * torch.rand(n, 3, generator=g, dtype=D),
        "opacities": torch.rand(n, generator=g, dtype=D).sqrt(),
        "sh": 0.3 * torch.randn(n, 16, 3, generator=g, dtype=D),
    }


def pixel_by_loop(camera: Camera, s: dict[str, Any], colours: Tensor, column: int, row: int):
    """One pixel by scalar arithmetic, items 1 to 6 of the contract in their order."""
    sigma = rotation.covariance(s["quaternions"], s["scales"])
    splats = []
    for i in range(len(s["means"])):
        x, y, z = (camera.rotation @ s["means"][i] + camera.translation).tolist()
        if z <= camera.near:
            continue
        fx, fy, cx, cy = (float(camera.K[a, b]) for a, b in ((0, 0), (1, 1), (0, 2), (1, 2)))
        middle_x, middle_y = (camera.width / 2 - cx) / fx, (camera.height / 2 - cy) / fy
        reach_x, reach_y = 1.3 * camera.width / 2 / fx, 1.3 * camera.height / 2 / fy
        u = max(middle_x - reach_x, min(middle_x + reach_x, x / z))
        v = max(middle_y - reach_y, min(middle_y + reach_y, y / z))
        jacobian = torch.tensor([[fx / z, 0, -fx * u / z], [0, fy / z, -fy * v / z]], dtype=D)
        flat = jacobian @ camera.rotation @ sigma[i] @ camera.rotation.T @ jacobian.T
        a, b, c = float(flat[0, 0]) + 0.3, float(flat[0, 1]), float(flat[1, 1]) + 0.3
        dx, dy = column + 0.5 - (fx * x / z + cx), row + 0.5 - (fy * y / z + cy)
        power = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / (a * c - b * b)
        splats.append((z, i, float(s["opacities"][i]) * math.exp(-0.5 * power)))
    left, colour, depth, far, median = 1.0, torch.zeros(3, dtype=D), 0.0, 0.0, 0.0
    weights: list[tuple[float, int]] = []
    for z, i, alpha in sorted(splats):
        alpha = min(0.99, alpha)
        if alpha < 1 / 255:
            continue
        if left * (1 - alpha) < 1e-4:
            break
        weight = alpha * left
        colour += weight * colours[i]
        depth += weight * z
        far += weight * float((s["means"][i] - camera.centre).norm())
        if left > 0.5 >= left * (1 - alpha):
            median = z
        left *= 1 - alpha
        weights.append((weight, i))
    total = max(1 - left, 1e-12)
    return colour, left, depth / total, far / total, median, sorted(weights, key=lambda w: -w[0])


@settings(max_examples=25)
@given(n=st.integers(0, 12), seed=st.integers(0, 2**16))
def test_every_output_matches_the_scalar_loop(n, seed):
    camera = view()
    s = scene(n, seed, camera)
    colours = torch.rand(n, 3, generator=torch.Generator().manual_seed(seed), dtype=D)
    background = torch.tensor([0.1, 0.2, 0.3], dtype=D)
    got = rasterize(
        camera, s["means"], s["quaternions"], s["scales"], s["opacities"], colours=colours,
        background=background, distance=True, median=True, contributors=3,
    )  # fmt: skip
    assert got.distance is not None
    assert got.median_depth is not None
    assert got.contributor_ids is not None
    assert got.contributor_weights is not None
    for row, column in [(0, 0), (3, 4), (6, 8), (2, 7)]:
        colour, left, depth, far, median, weights = pixel_by_loop(camera, s, colours, column, row)
        here = (row, column)
        assert_close(got.colour[here], colour + left * background, atol=1e-12, rtol=0)
        assert float(got.alpha[here]) == pytest.approx(1 - left, abs=1e-12)
        assert float(got.depth[here]) == pytest.approx(depth, abs=1e-9)
        assert float(got.distance[here]) == pytest.approx(far, abs=1e-9)
        assert float(got.median_depth[here]) == pytest.approx(median, abs=1e-12)
        padded = [*weights, (0.0, -1), (0.0, -1), (0.0, -1)][:3]
        assert got.contributor_ids[here].tolist() == [i for _, i in padded]
        assert got.contributor_weights[here].tolist() == pytest.approx([w for w, _ in padded])


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_gradients_of_every_parameter(mode):
    camera = view(5, 4)
    s = scene(3, 7, camera)
    if mode == "antialiased":  # colours come about in the same way: a degree of 1 is enough
        s["sh"] = s["sh"][:, :4]
    names = list(s)
    assert (rasterize(camera, **s, mode=mode).radii > 0).all()

    def outputs(*values: Tensor):
        inputs: Any = dict(zip(names, values, strict=True))
        out = rasterize(camera, **inputs, mode=mode, distance=True, median=True)
        every = (out.colour, out.alpha, out.depth, out.distance, out.median_depth)
        return tuple(value for value in every if value is not None)

    assert torch.autograd.gradcheck(outputs, [value.requires_grad_() for value in s.values()])


@settings(max_examples=20)
@given(n=st.integers(1, 10), seed=st.integers(0, 2**16))
def test_the_order_of_the_list_does_not_matter(n, seed):
    camera = view()
    s = scene(n, seed, camera)
    shuffle = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    a = rasterize(camera, **s)
    b = rasterize(camera, **{name: value[shuffle] for name, value in s.items()})
    assert_close(a.colour, b.colour, atol=1e-12, rtol=0)
    assert_close(a.radii[shuffle], b.radii)


@settings(max_examples=20)
@given(n=st.integers(1, 10), seed=st.integers(0, 2**16))
def test_moving_the_world_and_the_camera_together_changes_nothing(n, seed):
    camera = view()
    s = scene(n, seed, camera)
    colours = s.pop("sh")[:, 0]
    g = torch.Generator().manual_seed(seed)
    turn_q = torch.randn(1, 4, generator=g, dtype=D)
    turn, move = rotation.rotation_matrix(turn_q)[0], torch.randn(3, generator=g, dtype=D)
    pose = camera.world_to_camera.clone()
    pose[:3, :3] = camera.rotation @ turn.T
    pose[:3, 3] = camera.translation - pose[:3, :3] @ move
    moved = Camera(K=camera.K, world_to_camera=pose, width=camera.width, height=camera.height)
    w1, v1 = rotation.normalise(turn_q)[0, 0], rotation.normalise(turn_q)[0, 1:]
    w2, v2 = s["quaternions"][:, :1], s["quaternions"][:, 1:]
    product = torch.cat(
        [w1 * w2 - v2 @ v1[:, None], w1 * v2 + w2 * v1 + torch.linalg.cross(v1.expand_as(v2), v2)],
        dim=1,
    )
    other: dict[str, Any] = {**s, "means": s["means"] @ turn.T + move, "quaternions": product}
    a = rasterize(camera, **s, colours=colours)
    b = rasterize(moved, **other, colours=colours)
    assert_close(a.colour, b.colour, atol=1e-10, rtol=0)
    assert_close(a.depth, b.depth, atol=1e-10, rtol=0)


def test_ties_in_depth_are_drawn_in_the_order_of_the_list():
    camera = Camera(
        K=view().K, world_to_camera=torch.eye(4, dtype=D), width=9, height=7
    )  # fmt: skip
    count = 50
    colours = torch.rand(count, 3, generator=torch.Generator().manual_seed(0), dtype=D)
    got = rasterize(
        camera,
        torch.tensor([[0.0, 0, 2]], dtype=D).expand(count, 3),
        torch.tensor([[1.0, 0, 0, 0]], dtype=D).expand(count, 4),
        torch.full((count, 3), 0.3, dtype=D),
        torch.full((count,), 0.9, dtype=D),
        colours=colours,
        contributors=2,
    )
    assert got.contributor_ids is not None
    assert got.contributor_ids[4, 4].tolist() == [0, 1]


def test_a_pixel_stops_before_the_contribution_that_would_end_it():
    # alpha 0.99 twice leaves 1e-4, which is allowed; a third would leave 1e-6 and is not drawn.
    camera = Camera(K=view().K, world_to_camera=torch.eye(4, dtype=D), width=9, height=7)
    count = 3
    got = rasterize(
        camera,
        torch.tensor([[0.0, 0, 2], [0, 0, 3], [0, 0, 4]], dtype=D),
        torch.tensor([[1.0, 0, 0, 0]], dtype=D).expand(count, 4),
        torch.full((count, 3), 50.0, dtype=D),
        torch.ones(count, dtype=D),
        colours=torch.eye(3, dtype=D),
        contributors=3,
    )
    assert got.contributor_ids is not None
    drawn = [i for i in got.contributor_ids[3, 4].tolist() if i >= 0]
    left = 1 - float(got.alpha[3, 4])
    assert left == pytest.approx(0.01 if len(drawn) == 1 else 1e-4, rel=1e-6)
    assert len(drawn) < 3
    assert float(got.colour[3, 4, 2]) == 0


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_to_draw_is_the_background(n):
    camera = view()
    s = scene(n, 0, camera)
    s["opacities"] = torch.zeros(n, dtype=D)
    background = torch.tensor([0.1, 0.2, 0.3], dtype=D)
    got = rasterize(camera, **s, background=background, contributors=1)
    assert_close(got.colour, background.expand(7, 9, 3))
    assert not got.alpha.any()
    assert not got.depth.any()
    assert got.contributor_ids is not None
    assert (got.contributor_ids == -1).all()


def test_image_does_not_depend_on_how_pixels_are_split(monkeypatch):
    camera = view()
    s = scene(10, 3, camera)
    whole = rasterize(camera, **s)
    monkeypatch.setattr("splatproof.reference.rasterizer.rasterize.PAIRS_AT_ONCE", 30)
    assert_close(rasterize(camera, **s).colour, whole.colour, atol=1e-14, rtol=0)


def test_any_number_of_channels():
    camera = view()
    s = scene(6, 1, camera)
    s.pop("sh")
    many = torch.rand(6, 7, generator=torch.Generator().manual_seed(1), dtype=D)
    whole = rasterize(camera, **s, colours=many).colour
    part = rasterize(camera, **s, colours=many[:, 2:3]).colour
    assert whole.shape == (7, 9, 7)
    assert_close(whole[..., 2:3], part)


def test_antialiased_is_fainter_and_never_for_large_gaussians():
    camera = view()
    s = scene(1, 5, camera)
    s["scales"] = torch.full((1, 3), 1e-4, dtype=D)
    classic, smooth = (rasterize(camera, **s, mode=mode) for mode in ("classic", "antialiased"))
    assert float(smooth.alpha.max()) < 0.02 * float(classic.alpha.max()) + 1e-12
    s["scales"] = torch.full((1, 3), 30.0, dtype=D)
    classic, smooth = (rasterize(camera, **s, mode=mode) for mode in ("classic", "antialiased"))
    assert_close(smooth.alpha, classic.alpha, atol=1e-3, rtol=0)


def test_probe_collects_the_gradient_of_the_2d_means():
    camera = view()
    s = scene(5, 11, camera)
    weight = torch.randn(7, 9, 3, generator=torch.Generator().manual_seed(2), dtype=D)
    probe = ScreenProbe.zeros(5, s["means"])
    (rasterize(camera, **s, probe=probe).colour * weight).sum().backward()
    assert probe.signed.grad is not None
    assert probe.absolute.grad is not None

    # The same by differences: moving the principal point moves all means; one Gaussian, one pixel.
    one = {name: value[:1] for name, value in s.items()}
    single = ScreenProbe.zeros(1, s["means"])
    (rasterize(camera, **one, probe=single).colour * weight).sum().backward()
    step, want = 1e-6, []
    for axis in (0, 1):
        sides = []
        for sign in (1, -1):
            K = camera.K.clone()
            K[axis, 2] += sign * step
            near = Camera(K=K, world_to_camera=camera.world_to_camera, width=9, height=7)
            sides.append(float((rasterize(near, **one).colour * weight).sum()))
        want.append((sides[0] - sides[1]) / (2 * step))
    assert single.signed.grad is not None
    assert single.signed.grad[0].tolist() == pytest.approx(want, rel=1e-6)
    assert (probe.absolute.grad >= probe.signed.grad.abs() - 1e-12).all()


def test_absolute_probe_is_the_sum_over_pixels():
    camera = view(4, 3)
    s = scene(3, 13, camera)
    probe = ScreenProbe.zeros(3, s["means"])
    rasterize(camera, **s, probe=probe).colour.sum().backward()
    total = torch.zeros(3, 2, dtype=D)
    for pixel in range(12):
        single = ScreenProbe.zeros(3, s["means"])
        rasterize(camera, **s, probe=single).colour.reshape(12, 3)[pixel].sum().backward()
        assert single.signed.grad is not None
        total += single.signed.grad.abs()
    assert probe.absolute.grad is not None
    assert_close(probe.absolute.grad, total, atol=1e-12, rtol=0)


def test_exactly_one_of_colours_and_sh():
    camera = view()
    s = scene(2, 0, camera)
    with pytest.raises(ValueError, match="colours, sh or both|harmonics and colours"):
        rasterize(camera, **s, colours=torch.ones(2, 3, dtype=D))
