from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.splats import colours
from splatproof.reference.layered_memory import coordinate_field, multi_plane
from splatproof.reference.rasterizer import rotation
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.gaussians import Gaussians

D = torch.float64
UP = torch.tensor([0.0, 0, 1], dtype=D)


def nadir(height: float = 5.0, width: int = 8, rows: int = 6) -> Camera:
    """A camera above the origin that looks down: image y is world -y."""
    pose = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=D))
    pose[2, 3] = height
    intrinsics = torch.tensor([[8.0, 0, width / 2], [0, 8.0, rows / 2], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=rows)


def slab(n: int, seed: int) -> torch.Tensor:
    """A flat cloud: wide in x and y, one unit high."""
    g = torch.Generator().manual_seed(seed)
    return torch.rand(n, 3, generator=g, dtype=D) * torch.tensor([10.0, 8, 1], dtype=D)


@given(n=st.integers(30, 200), seed=st.integers(0, 2**16))
def test_normal_is_the_eigenvector_of_the_smallest_variance(n, seed):
    points = slab(n, seed)
    turn = rotation.rotation_matrix(
        torch.randn(1, 4, generator=torch.Generator().manual_seed(seed), dtype=D)
    )[0]
    up = turn @ UP
    normal = multi_plane.plane_normal(points @ turn.T + 100, up)
    _, vectors = torch.linalg.eigh(torch.cov((points @ turn.T).T))
    assert abs(float(normal @ vectors[:, 0])) == pytest.approx(1, abs=1e-9)
    assert float(normal @ up) > 0
    assert float(multi_plane.plane_normal(points @ turn.T, -up) @ up) < 0


OCTAHEDRON = torch.cat([torch.eye(3), -torch.eye(3)]).to(D)


@pytest.mark.parametrize(
    "points",
    [torch.zeros(0, 3, dtype=D), torch.ones(1, 3, dtype=D), OCTAHEDRON,
     torch.linspace(0, 1, 9, dtype=D)[:, None] * torch.tensor([1.0, 2, 3], dtype=D)],
)  # fmt: skip
def test_clouds_without_a_flattest_direction_are_reported(points):
    with pytest.raises(ValueError, match="no unique direction"):
        multi_plane.plane_normal(points, UP)


@given(count=st.integers(1, 9), seed=st.integers(0, 2**16))
def test_planes_cover_the_range_at_equal_distances(count, seed):
    points = slab(40, seed)
    heights = -multi_plane.plane_stack(points, UP, count).offsets
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    if count == 1:
        assert float(heights) == pytest.approx((low + high) / 2)
    else:
        assert heights.tolist() == pytest.approx(
            [low + (high - low) * k / (count - 1) for k in range(count)]
        )


@pytest.mark.parametrize(("count", "n"), [(0, 5), (3, 0)])
def test_no_plane_or_no_point_is_refused(count, n):
    with pytest.raises(ValueError, match="at least one"):
        multi_plane.plane_stack(torch.zeros(n, 3, dtype=D), UP, count)


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_rays_go_through_the_middle_of_their_cells(stride):
    camera = nadir()
    rays = multi_plane.pixel_rays(camera, stride)
    pixel, _ = project_points(camera, camera.centre + rays)
    assert pixel[0].tolist() == pytest.approx([stride / 2, stride / 2])
    assert_close(rays.norm(dim=1), torch.ones(len(rays), dtype=D))


@pytest.mark.parametrize("size", [(1, 9), (9, 1), (2, 2)])
def test_an_image_smaller_than_half_a_cell_has_no_ray(size):
    small = replace(nadir(), height=size[0], width=size[1])
    assert multi_plane.pixel_rays(small, 4).shape == (0, 3)


@given(seed=st.integers(0, 2**16), count=st.integers(1, 6), height=st.floats(0.5, 50))
def test_hits_lie_on_their_planes_and_on_their_rays(seed, count, height):
    camera = nadir(height)
    stack = multi_plane.plane_stack(slab(30, seed), UP, count)
    rays = multi_plane.pixel_rays(camera, 2)
    hits = multi_plane.ray_hits(stack, camera.centre, rays, camera.near)
    off = (hits.positions @ stack.normal + stack.offsets)[hits.valid].abs()
    assert (off <= 1e-5 * max(1, height)).all()
    along = hits.positions - camera.centre
    assert_close(along[hits.valid], (hits.distances[..., None] * rays[:, None])[hits.valid])
    assert (hits.distances[hits.valid] > camera.near).all()
    order = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
    other = multi_plane.ray_hits(
        replace(stack, offsets=stack.offsets[order]), camera.centre, rays, camera.near
    )
    assert_close(other.positions, hits.positions[:, order])


def test_parallel_rays_and_planes_behind_give_nothing():
    stack = multi_plane.PlaneStack(normal=UP, offsets=torch.tensor([0.0, -10.0, -5.0], dtype=D))
    rays = torch.tensor([[1.0, 0, 0], [1.0, 0, 1e-7], [0, 0, -1]], dtype=D)
    hits = multi_plane.ray_hits(stack, torch.tensor([0.0, 0, 5], dtype=D), rays, 0.01)
    # The last ray looks down from height 5: plane 0 is hit, 10 is behind, 5 is the centre itself.
    assert hits.valid.tolist() == [[False] * 3, [False] * 3, [True, False, False]]
    assert hits.positions.isfinite().all()


def test_bias_by_hand():
    hits = multi_plane.Hits(
        positions=torch.zeros(2, 3, 3, dtype=D),
        distances=torch.tensor([[2.0, 4.0, 3.0], [7.0, 0.0, 0.0]], dtype=D),
        valid=torch.tensor([[True, True, True], [True, False, False]]),
    )
    bias = multi_plane.opacity_bias(hits)
    assert_close(bias, torch.tensor([[-4.6, 1.4, -1.6], [1.4, 0, 0]], dtype=D))
    assert torch.sigmoid(bias[0, :2]).tolist() == pytest.approx([0.01, 0.80], abs=0.003)


def field(seed: int = 0) -> coordinate_field.CoordinateField:
    low, high = torch.tensor([-6.0, -6, -1], dtype=D), torch.tensor([6.0, 6, 2], dtype=D)
    generator = torch.Generator().manual_seed(seed)
    return coordinate_field.create(low, high, 9, generator, resolutions=(2, 4), width=8)


def test_field_is_trilinear_between_grid_points_and_constant_outside():
    f = field()
    f = replace(f, grids=f.grids[:1], hidden=f.hidden[:4])
    place = torch.tensor([[0.3, -2.0, 0.5]], dtype=D)
    share = (place - f.low) / (f.high - f.low)
    x, y, z = share[0].tolist()
    grid = f.grids[0][0]
    want = torch.zeros(4, dtype=D)
    for i, wz in enumerate((1 - z, z)):
        for j, wy in enumerate((1 - y, y)):
            for k, wx in enumerate((1 - x, x)):
                want += wx * wy * wz * grid[:, i, j, k]
    inner = want @ f.hidden + f.hidden_bias
    expected = (inner * torch.sigmoid(inner)) @ f.out + f.out_bias
    assert_close(coordinate_field.evaluate(f, place)[0], expected)
    outside = torch.stack([f.high, f.high + 5])
    values = coordinate_field.evaluate(f, outside)
    assert_close(values[0], values[1])


def test_field_gradients():
    f = field()
    place = (torch.rand(3, 3, generator=torch.Generator().manual_seed(1), dtype=D) - 0.5) * 3

    def run(a, b, hidden, out, where):
        return coordinate_field.evaluate(replace(f, grids=(a, b), hidden=hidden, out=out), where)

    inputs = [x.requires_grad_() for x in (*f.grids, f.hidden, f.out, place)]
    assert torch.autograd.gradcheck(run, inputs)


def test_a_box_without_volume_is_refused():
    with pytest.raises(ValueError, match="no volume"):
        coordinate_field.create(UP, UP, 9, torch.Generator())


def joint_scene(seed: int):
    camera = nadir()
    stack = multi_plane.plane_stack(slab(30, seed) - torch.tensor([5.0, 4, 0], dtype=D), UP, 3)
    rays = multi_plane.pixel_rays(camera, 2)
    hits = multi_plane.ray_hits(stack, camera.centre, rays, camera.near)
    g = torch.Generator().manual_seed(seed)
    explicit = Gaussians(
        means=torch.rand(5, 3, generator=g, dtype=D) * 2 - 1,
        quaternions=torch.randn(5, 4, generator=g, dtype=D),
        log_scales=torch.full((5, 3), -1.0, dtype=D),
        opacity_logits=torch.zeros(5, dtype=D),
        sh=torch.randn(5, 4, 3, generator=g, dtype=D) * 0.3,
    )
    return camera, hits, explicit


@settings(max_examples=10)
@given(seed=st.integers(0, 2**16))
def test_positions_do_not_depend_on_the_field(seed):
    camera, hits, _ = joint_scene(seed)
    made = [
        multi_plane.virtual_gaussians(
            coordinate_field.evaluate(field(k), hits.positions[hits.valid]), hits, camera, 2
        )
        for k in (0, 1)
    ]
    assert_close(made[0].means, made[1].means)
    assert not torch.equal(colours(made[0]), colours(made[1]))


@settings(max_examples=10)
@given(seed=st.integers(0, 2**16))
def test_clear_virtual_gaussians_leave_the_explicit_render(seed):
    camera, hits, explicit = joint_scene(seed)
    outputs = torch.zeros(int(hits.valid.sum()), 9, dtype=D)
    outputs[:, 3] = -1e3
    virtual = multi_plane.virtual_gaussians(outputs, hits, camera, 2)
    got = multi_plane.render_joint(camera, explicit, virtual)
    want = rasterize(
        camera, explicit.means, explicit.quaternions, explicit.scales, explicit.opacities,
        sh=explicit.sh,
    )  # fmt: skip
    assert_close(got.colour, want.colour)


def test_zero_field_output_covers_the_image():
    camera, hits, explicit = joint_scene(3)
    virtual = multi_plane.virtual_gaussians(
        torch.zeros(int(hits.valid.sum()), 9, dtype=D), hits, camera, 2
    )
    got = multi_plane.render_joint(camera, explicit, virtual)
    assert float(got.alpha.min()) > 0.5


def test_virtual_gaussians_by_loop():
    """Every hit has the bias of its own distance, and its ray's width there."""
    camera, hits, _ = joint_scene(5)
    valid = hits.valid.clone()
    valid[::3, 1] = False  # rays have unlike numbers of hits
    hits = replace(hits, valid=valid)
    g = torch.Generator().manual_seed(6)
    outputs = torch.randn(int(hits.valid.sum()), 9, generator=g, dtype=D)
    got = multi_plane.virtual_gaussians(outputs, hits, camera, 2)
    i = 0
    for ray in range(len(hits.valid)):
        met = [k for k in range(3) if bool(hits.valid[ray, k])]
        distances = [float(hits.distances[ray, k]) for k in met]
        for k, t in zip(met, distances, strict=True):
            near, far = min(distances), max(distances)
            bias = -4.6 + 6.0 * (t - near) / (far - near)
            assert float(torch.logit(got.opacities[i])) == pytest.approx(
                float(outputs[i, 3]) + bias
            )
            # 2 pixels at focal length 8 are t / 4 apart
            want = float(outputs[i, 4].exp()) * t / 4
            assert got.scales[i].tolist() == pytest.approx([want] * 3)
            assert_close(got.means[i], hits.positions[ray, k])
            assert_close(colours(got)[i], torch.sigmoid(outputs[i, :3]))
            i += 1
    assert i == len(outputs)


def test_without_bias_all_planes_start_alike():
    camera, hits, _ = joint_scene(5)
    plain = multi_plane.sites_of(hits, camera, 2, biased=False)
    biased = multi_plane.sites_of(hits, camera, 2)
    outputs = torch.zeros(len(plain.bias), 9, dtype=D)
    assert_close(multi_plane.decoded(outputs, plain).opacities, torch.full_like(plain.bias, 0.5))
    assert float(multi_plane.decoded(outputs, biased).opacities.std()) > 0.1
    assert_close(plain.spacing, biased.spacing)


def test_loss_reaches_the_field_through_the_joint_render():
    camera, hits, explicit = joint_scene(4)
    f = field(2)
    f.out.requires_grad_()
    outputs = coordinate_field.evaluate(f, hits.positions[hits.valid])
    virtual = multi_plane.virtual_gaussians(outputs, hits, camera, 2)
    multi_plane.render_joint(camera, explicit, virtual).colour.sum().backward()
    assert f.out.grad is not None
    # An isotropic Gaussian has no orientation: the rotation outputs must not move the image.
    assert (f.out.grad.abs().sum(dim=0)[:5] > 0).all()
    assert_close(f.out.grad[:, 5:], torch.zeros_like(f.out.grad[:, 5:]), atol=1e-9, rtol=0)
