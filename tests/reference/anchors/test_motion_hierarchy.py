import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
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
    """Anchors with motion; networks have random biases, residual ones are zero where rigid."""
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
        others = ("leaf_position", "colour", "opacity", "shape")
        stirred = {name: stir(getattr(networks, name)) for name in others}
        networks = replace(networks, layers=layers, **stirred)
    return anchors, networks


def embedding(values: Tensor) -> Tensor:
    """(x, sin 2^l x, cos 2^l x for l < 4) of one vector."""
    waves = [wave(values * 2.0**level) for level in range(4) for wave in (torch.sin, torch.cos)]
    return torch.cat([values, *waves])


def outputs(network: mlp.Mlp, inputs: Tensor, columns: int) -> Tensor:
    """What a network says of one row of inputs, a row a child."""
    return mlp.evaluate(network, inputs[None]).reshape(-1, columns)


def by_loop(anchors: mh.MotionAnchors, networks: mh.HierarchyNetworks, time: float, period: float):
    """Every anchor walked down its tree, child by child: the equations without a batch."""
    rows: dict[str, list] = {name: [] for name in ("mean", "turn", "scale", "opacity", "colour")}
    owners: list[int] = []
    moment = embedding(torch.tensor([time], dtype=D))
    for n in range(len(anchors.centres)):
        phase = math.sin(2 * math.pi * (time - float(anchors.peaks[n])) / period)
        root = anchors.centres[n] + period / (2 * math.pi) * phase * anchors.velocities[n]
        age = (time - float(anchors.peaks[n])) / math.exp(float(anchors.log_spans[n]))
        alive = math.exp(-0.5 * age**2)

        def inputs(at: Tensor, n: int = n) -> Tensor:
            return torch.cat([anchors.instances[n], embedding(at), moment])

        parents = [(root, anchors.features[n], anchors.log_scales[n])]
        for layer, offsets in zip(networks.layers, anchors.offsets[:-1], strict=True):
            children, steps = [], iter(offsets[n])
            for at, feature, size in parents:
                moves = outputs(layer.position, inputs(at), 3)
                features = outputs(layer.feature, inputs(at), len(feature))
                sizes = outputs(layer.scale, inputs(at), 3)
                for j in range(len(moves)):
                    where = at + next(steps) * size.exp() + moves[j]
                    children.append((where, feature + features[j], size + sizes[j]))
            parents = children
        steps = iter(anchors.offsets[-1][n])
        for at, feature, size in parents:
            moves = outputs(networks.leaf_position, inputs(at), 3)
            way = at - EYE
            sees = torch.cat([feature, way.norm()[None], way / way.norm()])
            shapes = outputs(networks.shape, sees, 7)
            opacities = outputs(networks.opacity, sees, 1)
            tints = outputs(networks.colour, sees, 3)
            for j in range(len(moves)):
                rows["mean"].append(at + next(steps) * size.exp() + moves[j])
                rows["turn"].append(shapes[j, 3:] / shapes[j, 3:].norm())
                rows["scale"].append(size.exp() / (1 + torch.exp(-shapes[j, :3])))
                rows["opacity"].append(alive / (1 + torch.exp(-opacities[j, 0])))
                rows["colour"].append(1 / (1 + torch.exp(-tints[j])))
                owners.append(n)
    return {name: torch.stack(values) for name, values in rows.items()}, owners


@pytest.mark.parametrize("sizes", [FLAT, SMALL, DEEP], ids=["2 layers", "3 layers", "4 layers"])
@given(n=st.integers(2, 4), seed=st.integers(0, 2**16), time=st.floats(-2, 2))
@settings(max_examples=4)
def test_all_outputs_by_loop(sizes, n, seed, time):
    anchors, networks = model(n, seed, sizes)
    got = mh.decode(anchors, networks, sizes, time, EYE)
    want, owners = by_loop(anchors, networks, time, 0.8)
    assert_close(got.means, want["mean"])
    assert_close(got.quaternions, want["turn"])
    assert_close(got.scales, want["scale"])
    assert_close(got.opacities, want["opacity"])
    assert_close(colours(got), want["colour"])
    assert got.rows is not None
    assert got.rows.tolist() == owners


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


def test_one_layer_more_needs_half_the_anchors_for_as_many_gaussians():
    """Table 8 of the paper by the second rule: 6 Gaussians a last anchor, N from 2 to 5."""
    stored = []
    for layers, gaussians in ((2, 6), (3, 12), (4, 24), (5, 48)):
        sizes = mh.by_leaf(mh.HierarchySettings(layers=layers), 6)
        assert sizes.gaussians == gaussians
        anchors, networks = model(480 // gaussians, 0, sizes)
        assert len(mh.decode(anchors, networks, sizes, 0.2, EYE).means) == 480
        nets = mh.stored_numbers(model(0, 0, sizes)[0], networks)
        stored.append((mh.stored_numbers(anchors, networks) - nets) / 480)
    # 55 numbers an anchor and 3 an offset; k + ... + k^(N - 2) + K offsets.
    assert stored == [73 / 6, 97 / 12, 145 / 24, 241 / 48]


def test_with_the_number_of_gaussians_held_depth_costs_storage():
    counts = [
        mh.stored_numbers(*model(480 // 12, 0, mh.HierarchySettings(layers=layers)))
        for layers in (2, 3, 4)
    ]
    assert counts == sorted(counts)


@pytest.mark.parametrize("wrong", [replace(SMALL, gaussians=7), mh.HierarchySettings(layers=5)])
def test_sizes_that_do_not_fit_are_refused(wrong):
    with pytest.raises(ValueError, match="by_leaf"):
        mh.create_networks(wrong, torch.Generator())


def test_one_layer_is_no_hierarchy():
    with pytest.raises(ValueError, match="2 layers"):
        mh.create_networks(replace(SMALL, layers=1), torch.Generator())
    with pytest.raises(ValueError, match="2 layers"):
        mh.by_leaf(replace(SMALL, layers=1), 6)


def test_gradients():
    anchors, networks = model(2, 4)
    names = ["centres", "features", "instances", "log_scales", "peaks", "velocities", "log_spans"]
    inputs = [getattr(anchors, name).clone().requires_grad_() for name in names]

    def run(*values):
        moved = replace(anchors, **dict(zip(names, values, strict=True)))
        got = mh.decode(moved, networks, SMALL, 0.3, EYE)
        return got.means, got.scales, got.opacities, colours(got)

    assert torch.autograd.gradcheck(run, inputs)
