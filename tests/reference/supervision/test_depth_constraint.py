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
def test_depths_are_the_weighted_distances(n, seed):
    camera = view()
    means, anchors, quaternions, scales, opacities = gaussians(n, seed)
    full = rasterize(
        camera, means, quaternions, scales, opacities,
        colours=torch.ones(n, 1, dtype=D), distance=True,
    )  # fmt: skip
    assert full.distance is not None
    got = dc.gaussian_depth(camera, means, quaternions, scales, opacities)
    assert_close(got, full.distance * full.alpha)  # not divided by the weights
    fixed = torch.full((n,), 0.95, dtype=D)
    far = (anchors - camera.centre).norm(dim=1)
    want = rasterize(camera, means, quaternions, scales, fixed, colours=far[:, None]).colour[..., 0]
    assert_close(dc.anchor_depth(camera, anchors, means, quaternions, scales), want)


def test_gradients_go_where_the_paper_sends_them():
    inputs = [x.requires_grad_() for x in gaussians(4, 1)]
    means, anchors, quaternions, scales, opacities = inputs
    dc.gaussian_depth(view(), means, quaternions, scales, opacities).sum().backward()
    assert means.grad is not None
    assert means.grad.any()
    assert opacities.grad is not None
    assert opacities.grad.any()
    assert quaternions.grad is None
    assert scales.grad is None
    for x in inputs:
        x.grad = None
    dc.anchor_depth(view(), anchors, means, quaternions, scales).sum().backward()
    assert anchors.grad is not None
    assert anchors.grad.any()
    assert means.grad is quaternions.grad is scales.grad is opacities.grad is None


def test_gradcheck():
    means, anchors, quaternions, scales, opacities = gaussians(3, 2)
    assert torch.autograd.gradcheck(
        lambda m, o: dc.gaussian_depth(view(), m, quaternions, scales, o),
        (means.requires_grad_(), opacities.requires_grad_()),
    )
    assert torch.autograd.gradcheck(
        lambda a: dc.anchor_depth(view(), a, means.detach(), quaternions, scales),
        anchors.requires_grad_(),
    )


def depth(seed: int, h: int = 9, w: int = 11) -> torch.Tensor:
    return 1 + torch.rand(h, w, generator=torch.Generator().manual_seed(seed), dtype=D)


ALL = torch.ones(9, 11, dtype=torch.bool)


@given(seed=st.integers(0, 2**16), a=st.floats(0.01, 100), b=st.floats(-50, 50))
def test_normalising_forgets_scale_and_shift(seed, a, b):
    z = depth(seed)
    assert_close(dc.normalise_depth(a * z + b, ALL), dc.normalise_depth(z, ALL), atol=1e-7, rtol=0)


def test_normalising_by_hand_and_against_outliers():
    z = torch.arange(101, dtype=D).reshape(1, 101)
    valid = torch.ones(1, 101, dtype=torch.bool)
    got = dc.normalise_depth(z, valid)
    assert float(got[0, 2]) == pytest.approx(0)
    assert float(got[0, 98]) == pytest.approx(1)
    wild = z.clone()
    wild[0, 100] = 1e9
    assert_close(dc.normalise_depth(wild, valid)[0, :99], got[0, :99])


@pytest.mark.parametrize("bad", [torch.inf, torch.nan])
def test_invalid_pixels_never_spread(bad):
    z, valid = depth(3), ALL.clone()
    valid[2, 5] = False
    z[2, 5] = bad
    other = z.clone()
    other[2, 5] = 7.0
    got = dc.normalise_depth(z, valid)
    assert_close(got, dc.normalise_depth(other, valid))
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
    got = dc.normalise_depth(z, valid)
    assert not got.any()
    got.sum().backward()
    assert z.grad is not None
    assert not z.grad.any()


def test_disparity_is_inverted():
    got = dc.from_disparity(torch.tensor([[0.5, 4.0, 0.0, -1.0]], dtype=D))
    assert got.tolist() == [[2.0, 0.25, torch.inf, torch.inf]]


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
    target = dc.normalise_depth(reference, ALL)
    want = sum(
        s * float((weight * (dc.normalise_depth(z, ALL) - target).abs()).mean())
        for s, z in ((0.5, gaussian), (2.0, anchor))
    )
    got = dc.depth_loss(gaussian, anchor, reference, ALL, weight, strength)
    assert float(got) == pytest.approx(want)
    same = dc.depth_loss(reference, 3 * reference + 1, reference, ALL, weight, strength)
    assert float(same) == pytest.approx(0, abs=1e-9)
