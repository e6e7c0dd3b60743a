import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.splats import colours
from splatproof.reference.anchors import motion_hierarchy as mh
from splatproof.reference.types import mlp

D = torch.float64
EYE = torch.tensor([0.0, -6.0, 1.0], dtype=D)
SMALL = mh.HierarchySettings(features=6, instance=3, gaussians=6, period=0.8)
DEEP = replace(SMALL, layers=4, gaussians=8)
FLAT = replace(SMALL, layers=2, gaussians=3)


def model(n: int, seed: int, sizes: mh.HierarchySettings = SMALL, *, rigid: bool = False):
    """Anchors with motion; residual networks are random, or zero where rigid."""
    g = torch.Generator().manual_seed(seed)
    counts = [sizes.children**i for i in range(1, sizes.layers - 1)] + [sizes.gaussians]

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=g, dtype=D)

    anchors = mh.MotionAnchors(
        centres=draw(n, 3), features=draw(n, sizes.features), instances=draw(n, sizes.instance),
        quaternions=draw(n, 4), log_scales=draw(n, 3) - 2, peaks=draw(n), velocities=draw(n, 3),
        log_spans=draw(n), offsets=tuple(draw(n, count, 3) for count in counts),
    )  # fmt: skip
    networks = mh.create_networks(sizes, g, D)
    if not rigid:

        def stir(net: mlp.Mlp) -> mlp.Mlp:
            return mlp.change(net, lambda p: p + 0.1 * draw(*p.shape))

        layers = tuple(
            mh.LayerNetworks(**{name: stir(net) for name, net in vars(layer).items()})
            for layer in networks.layers
        )
        networks = replace(networks, layers=layers, leaf_position=stir(networks.leaf_position))
    return anchors, networks


def test_positions_by_hand_of_the_equations():
    """One anchor of three layers, unrolled by hand: two sub-anchors with three Gaussians each."""
    anchors, networks = model(1, 3)
    time = 0.37
    sway = 0.8 / (2 * math.pi) * math.sin(2 * math.pi * (time - float(anchors.peaks)) / 0.8)
    root = anchors.centres[0] + sway * anchors.velocities[0]
    moment = torch.full((1, 1), time, dtype=D)
    first = torch.cat([anchors.instances, mh.code(root[None]), mh.code(moment)], dim=1)
    layer = networks.layers[0]
    moves = mlp.evaluate(layer.position, first).reshape(2, 3)
    sizes = mlp.evaluate(layer.scale, first).reshape(2, 3) + anchors.log_scales
    want = []
    for child in range(2):
        here = root + anchors.offsets[0][0, child] * anchors.log_scales[0].exp() + moves[child]
        second = torch.cat([anchors.instances, mh.code(here[None]), mh.code(moment)], dim=1)
        leaf = mlp.evaluate(networks.leaf_position, second).reshape(3, 3)
        for j in range(3):
            step = anchors.offsets[1][0, 3 * child + j] * sizes[child].exp()
            want.append(here + step + leaf[j])
    assert_close(mh.decode(anchors, networks, SMALL, time, EYE).means, torch.stack(want))


@pytest.mark.parametrize("sizes", [FLAT, SMALL, DEEP], ids=["2 layers", "3 layers", "4 layers"])
@pytest.mark.parametrize("n", [0, 1, 4])
def test_each_anchor_has_its_gaussians(sizes, n):
    got = mh.decode(*model(n, 0, sizes), sizes, 0.1, EYE)
    assert len(got.means) == len(got.opacities) == n * sizes.gaussians
    assert got.means.isfinite().all()


@given(seed=st.integers(0, 2**16), time=st.floats(-50, 50))
@settings(max_examples=25)
def test_without_velocity_and_residuals_the_scene_stands_still(seed, time):
    anchors, networks = model(3, seed, rigid=True)
    anchors = replace(anchors, velocities=torch.zeros(3, 3, dtype=D))
    a = mh.decode(anchors, networks, SMALL, time, EYE)
    b = mh.decode(anchors, networks, SMALL, 0.0, EYE)
    assert_close(a.means, b.means)
    assert_close(colours(a), colours(b))


@given(seed=st.integers(0, 2**16), time=st.floats(-5, 5))
@settings(max_examples=25)
def test_rigid_motion_repeats_with_the_period_and_moves_all_children_alike(seed, time):
    anchors, networks = model(3, seed, rigid=True)
    a, b, c = (
        mh.decode(anchors, networks, SMALL, t, EYE).means for t in (time, time + 0.8, time + 0.3)
    )
    assert_close(a, b, atol=1e-9, rtol=0)
    moved = (c - a).reshape(3, 6, 3)
    assert_close(moved, moved[:, :1].expand(3, 6, 3), atol=1e-9, rtol=0)


@given(seed=st.integers(0, 2**16))
@settings(max_examples=25)
def test_shifting_the_anchors_shifts_all_children(seed):
    anchors, networks = model(3, seed, rigid=True)
    shift = torch.tensor([1.0, -2.0, 0.5], dtype=D)
    a = mh.decode(anchors, networks, SMALL, 0.2, EYE)
    b = mh.decode(
        replace(anchors, centres=anchors.centres + shift), networks, SMALL, 0.2, EYE + shift
    )
    assert_close(b.means, a.means + shift)
    assert_close(colours(b), colours(a))
    assert_close(b.opacities, a.opacities)


def test_opacity_fades_with_the_life_of_its_anchor():
    anchors, networks = model(2, 1, rigid=True)
    anchors = replace(anchors, velocities=torch.zeros(2, 3, dtype=D))
    tau, beta = float(anchors.peaks[0]), float(anchors.log_spans[0].exp())
    full = mh.decode(anchors, networks, SMALL, tau, EYE).opacities[:6]
    faded = mh.decode(anchors, networks, SMALL, tau + 2 * beta, EYE).opacities[:6]
    assert_close(faded, full * math.exp(-2.0))
    gone = mh.decode(anchors, networks, SMALL, tau + 1e6, EYE).opacities[:6]
    assert float(gone.max()) < 1e-6


def test_children_inherit_the_instance_and_refine_the_feature():
    anchors, networks = model(2, 2, rigid=True)
    other = replace(anchors, features=anchors.features + 1)
    a, b = (mh.decode(x, networks, SMALL, 0.1, EYE) for x in (anchors, other))
    assert not torch.allclose(colours(a), colours(b))
    assert_close(a.means, b.means)


def test_storage_counts_what_is_saved():
    anchors, networks = model(5, 0, mh.HierarchySettings())
    # centre 3, feature 32, instance 8, quaternion 4, scale 3, tau 1, v 3, beta 1, offsets 2 and 12.
    per_anchor = 3 + 32 + 8 + 4 + 3 + 1 + 3 + 1 + 3 * (2 + 12)
    reads, sees = 8 + 9 * 4, 32 + 4
    nets = sum(
        (a * 32 + 32) + (32 * out + out)
        for a, out in [(reads, 6), (reads, 64), (reads, 6), (reads, 18),
                       (sees, 18), (sees, 6), (sees, 42)]
    )  # fmt: skip
    assert mh.stored_numbers(anchors, networks) == 5 * per_anchor + nets


@pytest.mark.parametrize("wrong", [replace(SMALL, layers=1), replace(SMALL, gaussians=7)])
def test_sizes_that_do_not_fit_are_refused(wrong):
    with pytest.raises(ValueError, match="multiple"):
        mh.create_networks(wrong, torch.Generator())


def test_gradients():
    anchors, networks = model(2, 4)
    names = ["centres", "features", "instances", "log_scales", "peaks", "velocities", "log_spans"]
    inputs = [getattr(anchors, name).clone().requires_grad_() for name in names]

    def run(*values):
        moved = replace(anchors, **dict(zip(names, values, strict=True)))
        got = mh.decode(moved, networks, SMALL, 0.3, EYE)
        return got.means, got.scales, got.opacities, colours(got)

    assert torch.autograd.gradcheck(run, inputs)
