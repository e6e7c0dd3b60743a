import math

import cv2
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.supervision import depth_supervision as ds

D = torch.float64


def picture(h: int, w: int, seed: int) -> Tensor:
    return torch.rand(h, w, 3, generator=torch.Generator().manual_seed(seed), dtype=D)


def depth_map(h: int, w: int, seed: int) -> Tensor:
    return 1 + torch.rand(h, w, generator=torch.Generator().manual_seed(seed), dtype=D)


@given(h=st.integers(1, 8), w=st.integers(1, 8), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_edge_weight_matches_opencv(h, w, seed):
    image = picture(h, w, seed)
    total = torch.zeros(h, w, dtype=D)
    for dx, dy in ((1, 0), (0, 1)):
        sobel = cv2.Sobel(image.numpy(), cv2.CV_64F, dx, dy, borderType=cv2.BORDER_REPLICATE) / 8
        total += torch.from_numpy(sobel).square().sum(dim=-1)
    assert_close(ds.edge_weight(image, 2.0), torch.exp(-2.0 * total.sqrt()))


def test_a_ramp_weighs_by_its_slope():
    image = (0.1 * torch.arange(6, dtype=D))[None, :, None].expand(5, 6, 3)
    want = math.exp(-3.0 * 0.1 * math.sqrt(3))
    assert float(ds.edge_weight(image, 3.0)[2, 3]) == pytest.approx(want)


@given(h=st.integers(1, 6), w=st.integers(1, 6), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_smoothness_by_loop(h, w, seed):
    image, depth = picture(h, w, seed), depth_map(h, w, seed)
    weight, total = ds.edge_weight(image, 1.5), 0.0
    for y in range(h):
        for x in range(w):
            step = abs(depth[y, x + 1] - depth[y, x]) if x + 1 < w else 0
            step += abs(depth[y + 1, x] - depth[y, x]) if y + 1 < h else 0
            total += float(weight[y, x] * step)
    assert float(ds.smoothness_loss(depth, image, 1.5)) == pytest.approx(total / (h * w))
    assert float(ds.smoothness_loss(torch.full((h, w), 3.0, dtype=D), image, 1.5)) == 0


@given(h=st.integers(1, 6), w=st.integers(1, 6), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_outliers_by_loop(h, w, seed):
    image, ranks, delta = picture(h, w, seed), depth_map(h, w, seed) - 1, 0.2
    weight, total = ds.edge_weight(image, 1.0), 0.0
    for y in range(h):
        for x in range(w):
            near = ranks[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
            off = float((ranks[y, x] - near.mean()).abs())
            total += float(weight[y, x]) * off * (off > delta)
    got = ds.outlier_loss(ranks, image, 1.0, delta)
    assert float(got) == pytest.approx(total / (h * w), abs=1e-12)
    assert float(ds.outlier_loss(ranks, image, 1.0, 1.1)) == 0


def test_lidar_counts_hits_only():
    depth, lidar = depth_map(3, 4, 0), torch.full((3, 4), torch.nan, dtype=D)
    hit = torch.zeros(3, 4, dtype=torch.bool)
    depth.requires_grad_()
    none = ds.lidar_loss(depth, lidar, hit)
    none.backward()
    assert float(none.detach()) == 0
    assert depth.grad is not None
    assert not depth.grad.any()
    hit[1, 2], hit[0, 0] = True, True
    here = depth.detach()
    lidar[1, 2], lidar[0, 0] = float(here[1, 2]) + 0.5, float(here[0, 0]) - 0.1
    assert float(ds.lidar_loss(here, lidar, hit)) == pytest.approx(0.3)


def test_sky_by_hand():
    alpha = torch.tensor([[0.25, 0.9]], dtype=D)
    loss = ds.sky_loss(alpha, torch.tensor([[True, False]]))
    assert float(loss) == pytest.approx(-(math.log(0.75) + math.log(0.9)) / 2)


def test_sky_is_finite_at_the_ends():
    alpha = torch.tensor([[0.0, 1.0]], dtype=D)
    assert torch.isfinite(ds.sky_loss(alpha, torch.tensor([[False, True]])))
    assert float(ds.sky_loss(alpha, torch.tensor([[True, False]]))) < 1e-5


def test_no_pixel_says_nothing_of_the_sky():
    none = torch.zeros(1, 0, dtype=D)
    assert float(ds.sky_loss(none, none > 0)) == 0


def test_gradients():
    image, depth = picture(4, 5, 1), depth_map(4, 5, 1).requires_grad_()
    hit = torch.rand(4, 5, generator=torch.Generator().manual_seed(0)) > 0.5
    assert torch.autograd.gradcheck(lambda z: ds.smoothness_loss(z, image, 1.0), depth)
    assert torch.autograd.gradcheck(lambda z: ds.outlier_loss(z, image, 1.0, 0.1), depth)
    assert torch.autograd.gradcheck(lambda z: ds.lidar_loss(z, depth_map(4, 5, 9), hit), depth)
    alpha = (depth.detach() - 1).clamp(0.05, 0.95).requires_grad_()
    assert torch.autograd.gradcheck(lambda a: ds.sky_loss(a, hit), alpha)
