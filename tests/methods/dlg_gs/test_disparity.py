"""Rendered disparities with the gradient of an inverse distance by hand against the reference's, which autograd derives."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.tiny_scene import camera
from splatproof.methods.dlg_gs.disparity import anchor_disparity, gaussian_disparity, inverses
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.supervision import depth_constraint as reference

D = torch.float64
SEEN = camera(2)
"""Its centre is 4 scene units from the origin or so, its near plane 0.01 in front of it."""


def drawn(count, seed, dtype=D):
    """Gaussians about the origin: means, quaternions, scales, opacities."""
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.rand(*shape, generator=g, dtype=dtype)
    return draw(count, 3) - 0.5, draw(count, 4) - 0.5, 0.1 + 0.2 * draw(count, 3), draw(count)


@settings(max_examples=30)
@given(
    count=st.integers(0, 20), seed=st.integers(0, 2**16), depth=st.sampled_from(["distance", "z"]),
    near=st.sampled_from([0.01, 4.0]), dtype=st.sampled_from([D, torch.float32]),
)  # fmt: skip
def test_inverses_are_the_references(count, seed, depth, near, dtype):
    where = replace(SEEN, near=near)
    g = torch.Generator().manual_seed(seed)
    positions = torch.randn(count, 3, generator=g, dtype=dtype)
    given_back = torch.randn(count, generator=g, dtype=dtype)
    found = []
    for invert in (inverses, reference._inverses):
        leaf = positions.clone().requires_grad_()
        made = invert(where, leaf, depth)
        found.append((made.detach(), *torch.autograd.grad(made, leaf, given_back)))
    (value, gradient), (want, by) = found
    assert_close(value, want)
    assert_close(gradient, by, atol=8 * torch.finfo(dtype).eps, rtol=1e-5 if dtype != D else 1e-12)


def test_what_is_nearer_than_the_near_plane_pulls_on_nothing():
    centre = SEEN.centre
    positions = torch.stack([centre, centre + 0.005, centre + 0.5]).requires_grad_()
    made = inverses(SEEN, positions, "distance")
    assert_close(made[:2], torch.full((2,), 100.0, dtype=D))
    made.sum().backward()
    assert positions.grad is not None
    assert not positions.grad[:2].any()
    assert positions.grad[2].all()


@pytest.mark.parametrize("depth", ["distance", "z"])
def test_disparities_and_their_gradients_are_the_references(depth):
    """That of anchors is asked for once an anchor, though several Gaussians have one and some anchors have none."""
    means, quaternions, scales, opacities = drawn(9, 3)
    anchors, rows = drawn(4, 4)[0], torch.tensor([0, 0, 1, 1, 1, 3, 3, 3, 3])
    made = []
    for ours in (True, False):
        leaves = [
            t.clone().requires_grad_() for t in (means, opacities, anchors, quaternions, scales)
        ]
        u, o, a, q, s = leaves
        if ours:
            near = gaussian_disparity(SEEN, u, q, s, o, depth=depth, rasterizer=rasterize)
            hung = anchor_disparity(SEEN, a, rows, u, q, s, depth=depth, rasterizer=rasterize)
        else:
            near = reference.gaussian_disparity(SEEN, u, q, s, o, depth=depth)
            hung = reference.anchor_disparity(SEEN, a[rows], u, q, s, depth=depth)
        assert near.max() > 0.1
        assert hung.max() > 0.1
        by_near = torch.autograd.grad(near.square().sum(), leaves, allow_unused=True)
        by_hung = torch.autograd.grad(hung.square().sum(), leaves, allow_unused=True)
        made.append((near, hung, by_near, by_hung))
    assert [g is not None for g in made[0][2]] == [True, True, False, False, False]
    assert [g is not None for g in made[0][3]] == [False, False, True, False, False]
    for found, want in zip(made[0], made[1], strict=True):
        assert_close(found, want)
