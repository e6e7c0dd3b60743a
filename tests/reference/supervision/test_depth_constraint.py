import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.supervision import depth_constraint as dc
from splatproof.reference.types.camera import Camera

D = torch.float64


def view() -> Camera:
    intrinsics = torch.tensor([[10.0, 0, 4], [0, 10.0, 3], [0, 0, 1]], dtype=D)
    pose = torch.eye(4, dtype=D)
    pose[2, 3] = 0.5
    return Camera(K=intrinsics, world_to_camera=pose, width=8, height=6)


def gaussians(n: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    means = torch.randn(n, 3, generator=g, dtype=D) * 0.4 + torch.tensor([0.0, 0, 2], dtype=D)
    anchors = means + 0.2 * torch.randn(n, 3, generator=g, dtype=D)
    quaternions = torch.randn(n, 4, generator=g, dtype=D)
    scales = 0.1 + 0.3 * torch.rand(n, 3, generator=g, dtype=D)
    return means, anchors, quaternions, scales, torch.rand(n, generator=g, dtype=D)


@given(n=st.integers(0, 6), seed=st.integers(0, 2**16))
@settings(max_examples=20)
def test_disparities_are_the_weighted_inverse_distances(n, seed):
    camera = view()
    means, anchors, quaternions, scales, opacities = gaussians(n, seed)
    full = rasterize(
        camera, means, quaternions, scales, opacities,
        colours=1 / (means - camera.centre).norm(dim=1, keepdim=True),
    )  # fmt: skip
    got = dc.gaussian_disparity(camera, means, quaternions, scales, opacities)
    assert_close(got, full.colour[..., 0])  # not divided by the weights
    fixed = torch.full((n,), 0.95, dtype=D)
    far = (anchors - camera.centre).norm(dim=1)
    want = rasterize(camera, means, quaternions, scales, fixed, colours=1 / far[:, None]).colour[
        ..., 0
    ]
    assert_close(dc.anchor_disparity(camera, anchors, means, quaternions, scales), want)


def wide() -> Camera:
    """90 degrees from side to side, turned and off the origin: its corners are 1.7 z away."""
    intrinsics = torch.tensor([[16.0, 0, 16], [0, 16.0, 16], [0, 0, 1]], dtype=D)
    pose = torch.eye(4, dtype=D)
    pose[0, 0] = pose[2, 2] = 0.6
    pose[0, 2], pose[2, 0] = 0.8, -0.8
    pose[:3, 3] = torch.tensor([0.3, -0.2, 0.1], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=32, height=32)


def dots_on_a_wall(camera: Camera):
    """A dot on every fourth pixel, at the depth of a slanted wall; the wall's z; where dots are."""
    row, column = torch.meshgrid(*(torch.arange(32, dtype=D) + 0.5,) * 2, indexing="ij")
    x, y = (column - 16) / 16, (row - 16) / 16
    z = 1 / (0.3 + 0.1 * x - 0.05 * y)
    seen = torch.zeros(32, 32, dtype=torch.bool)
    seen[2::4, 2::4] = True  # a dot's footprint ends before the next
    inside = torch.stack([x * z, y * z, z], dim=-1)[seen]
    return (inside - camera.translation) @ camera.rotation, z, seen


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("z", 0, 1e-9), ("distance", 0.02, 1)], ids=["z", "distance"]
)
def test_true_geometry_has_no_error_against_true_disparity_by_z_alone(kind, least, most):
    camera = wide()
    means, z, seen = dots_on_a_wall(camera)
    shape = torch.tensor([[1.0, 0, 0, 0]], dtype=D).expand(len(means), 4), 1e-6 + 0 * means
    gaussian = dc.gaussian_disparity(camera, means, *shape, 0.95 + 0 * means[:, 0], depth=kind)
    anchor = dc.anchor_disparity(camera, means, means, *shape, depth=kind)
    assert_close(gaussian, anchor)
    target, ones = dc.normalise_disparity(1 / z, seen), torch.ones_like(z)
    error = float(dc.disparity_error(gaussian, target, seen, ones)) / float(seen.double().mean())
    assert least <= error <= most


def test_gradients_go_where_the_paper_sends_them():
    inputs = [x.requires_grad_() for x in gaussians(4, 1)]
    means, anchors, quaternions, scales, opacities = inputs
    dc.gaussian_disparity(view(), means, quaternions, scales, opacities).sum().backward()
    assert means.grad is not None
    assert means.grad.any()
    assert opacities.grad is not None
    assert opacities.grad.any()
    assert quaternions.grad is None
    assert scales.grad is None
    for x in inputs:
        x.grad = None
    dc.anchor_disparity(view(), anchors, means, quaternions, scales).sum().backward()
    assert anchors.grad is not None
    assert anchors.grad.any()
    assert means.grad is quaternions.grad is scales.grad is opacities.grad is None


def test_gradcheck():
    means, anchors, quaternions, scales, opacities = gaussians(3, 2)
    assert torch.autograd.gradcheck(
        lambda m, o: dc.gaussian_disparity(view(), m, quaternions, scales, o),
        (means.requires_grad_(), opacities.requires_grad_()),
    )
    assert torch.autograd.gradcheck(
        lambda a: dc.anchor_disparity(view(), a, means.detach(), quaternions, scales),
        anchors.requires_grad_(),
    )


def depth(seed: int, h: int = 9, w: int = 11) -> torch.Tensor:
    return 1 + torch.rand(h, w, generator=torch.Generator().manual_seed(seed), dtype=D)


ALL = torch.ones(9, 11, dtype=torch.bool)
WEIGHTS = dc.DepthWeights()


@given(seed=st.integers(0, 2**16), a=st.floats(0.01, 100), b=st.floats(-50, 50))
def test_normalising_forgets_scale_and_shift(seed, a, b):
    z = depth(seed)
    assert_close(
        dc.normalise_disparity(a * z + b, ALL), dc.normalise_disparity(z, ALL), atol=1e-7, rtol=0
    )


def test_normalising_by_hand_and_against_outliers():
    z = torch.arange(101, dtype=D).reshape(1, 101)
    valid = torch.ones(1, 101, dtype=torch.bool)
    got = dc.normalise_disparity(z, valid)
    assert float(got[0, 2]) == pytest.approx(0)
    assert float(got[0, 98]) == pytest.approx(1)
    wild = z.clone()
    wild[0, 100] = 1e9
    assert_close(dc.normalise_disparity(wild, valid)[0, :99], got[0, :99])


@pytest.mark.parametrize("bad", [torch.inf, torch.nan])
def test_invalid_pixels_never_spread(bad):
    z, valid = depth(3), ALL.clone()
    valid[2, 5] = False
    z[2, 5] = bad
    other = z.clone()
    other[2, 5] = 7.0
    got = dc.normalise_disparity(z, valid)
    assert_close(got, dc.normalise_disparity(other, valid))
    assert float(got[2, 5]) == 0


@pytest.mark.parametrize("kind", ["constant", "none", "one"])
def test_maps_without_a_range_are_zero(kind):
    z, valid = depth(1).requires_grad_(), ALL.clone()
    if kind == "constant":
        z = (z.detach() * 0 + 3).requires_grad_()
    if kind != "constant":
        valid[:] = False
    if kind == "one":
        valid[4, 4] = True
    got = dc.normalise_disparity(z, valid)
    assert not got.any()
    got.sum().backward()
    assert z.grad is not None
    assert not z.grad.any()


@given(seed=st.integers(0, 2**16), a=st.floats(0.1, 10), b=st.floats(0, 5))
def test_a_perfect_model_has_no_loss_whatever_the_network_adds(seed, a, b):
    """A network says a d + b of the disparity d: its inverse is no affine map of depth."""
    true = 1 / depth(seed)
    loss = dc.depth_loss(true, true, a * true + b, ALL, torch.ones(9, 11, dtype=D), WEIGHTS)
    assert float(loss) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("kind", ["distance", "z"])
def test_what_nothing_covers_is_infinitely_far_and_a_mean_at_the_camera_is_finite(kind):
    means, anchors, quaternions, scales, opacities = gaussians(3, 0)
    anchors[0] = means[0] = view().centre
    means, anchors = means.requires_grad_(), anchors.requires_grad_()
    seen = dc.gaussian_disparity(view(), means, quaternions, scales, opacities, depth=kind)
    hung = dc.anchor_disparity(view(), anchors, means, quaternions, scales, depth=kind)
    (seen.sum() + hung.sum()).backward()
    for x in (means, anchors):
        assert x.grad is not None
        assert x.grad.isfinite().all()
    none = dc.gaussian_disparity(view(), means[:0], quaternions[:0], scales[:0], opacities[:0])
    assert not none.any()


def test_the_range_is_taken_as_given():
    """Without gradient through the quantiles, each pixel counts by one over the range."""
    z = depth(2).requires_grad_()
    dc.normalise_disparity(z, ALL).sum().backward()
    low, high = torch.quantile(z.detach(), torch.tensor([0.02, 0.98], dtype=D))
    assert z.grad is not None
    assert_close(z.grad, torch.full_like(z.grad, float(1 / (high - low))))


def test_the_anchor_term_reaches_centres_only_so_they_have_a_rate():
    """Gaussians as Scaffold-GS makes them: of centre, offset and reach only the centre can follow."""
    means, centres, quaternions, scales, _ = gaussians(6, 3)
    stored = [centres, means - centres, torch.ones(6, 1, dtype=D)]
    centres, offsets, reach = (x.requires_grad_() for x in stored)
    hung = dc.anchor_disparity(view(), centres, centres + offsets * reach, quaternions, scales)
    every, nothing = torch.ones(6, 8, dtype=torch.bool), torch.zeros(6, 8, dtype=D)
    near = 1 / depth(4, 6, 8)
    dc.depth_loss(nothing, hung, near, every, nothing + 1, WEIGHTS).backward()
    assert centres.grad is not None
    assert centres.grad.any()
    assert offsets.grad is reach.grad is None
    assert WEIGHTS.anchor_rate > 0


def test_weight_by_hand_and_without_gradient():
    a = torch.zeros(1, 2, 3, dtype=D, requires_grad=True)
    b = torch.tensor([[[0.3, 0.6, 0.0], [4.0, 4.0, 4.0]]], dtype=D)
    w = dc.appearance_weight(a, b)
    assert w.tolist() == [[pytest.approx(0.7), 0.0]]
    assert not w.requires_grad
    assert_close(dc.appearance_weight(b, b), torch.ones(1, 2, dtype=D))


def test_loss_by_hand():
    reference, strength = depth(0), dc.DepthWeights(gaussian=0.5, anchor=2.0)
    gaussian, anchor, weight = depth(1), depth(2), depth(3) - 1
    target = dc.normalise_disparity(reference, ALL)
    want = sum(
        s * float((weight * (dc.normalise_disparity(z, ALL) - target).abs()).mean())
        for s, z in ((0.5, gaussian), (2.0, anchor))
    )
    got = dc.depth_loss(gaussian, anchor, reference, ALL, weight, strength)
    assert float(got) == pytest.approx(want)
    same = dc.depth_loss(reference, 3 * reference + 1, reference, ALL, weight, strength)
    assert float(same) == pytest.approx(0, abs=1e-9)


@given(st.integers(1, 400), st.integers(0, 2**31))
def testquantiles_are_torchs(count, seed):
    values = torch.randn(count, generator=torch.Generator().manual_seed(seed)).round(decimals=1)
    shares = (0.0, *dc.QUANTILES, 0.5, 1.0)
    for share, ours in zip(shares, dc.quantiles(values, shares), strict=True):
        assert_close(ours, values.quantile(share))
