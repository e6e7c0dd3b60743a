"""The native decoding of moving anchors against the reference in float64: what is decoded, and every gradient."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from splatproof.methods.hdgs import decode as twin
from splatproof.methods.hdgs import networks as nets
from splatproof.methods.kernels import hierarchy as native
from splatproof.reference.anchors import motion_hierarchy
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchyNetworks,
    HierarchySettings,
    MotionAnchors,
    by_leaf,
)
from splatproof.reference.rasterizer import rotation
from splatproof.reference.types import mlp
from splatproof.reference.types.splats import Splats

VALUES = {"means": 3, "quaternions": 4, "scales": 3, "opacities": 1, "colours": 3}
"""What is decoded for each Gaussian, and how many numbers of it."""
CAMERA = torch.tensor([0.3, -2.0, 0.5])
TIME = 0.4
NEAR = 1e-4
"""Anchors with a hidden unit this close to the bend of its activation, where rounding decides (float32 leaves 1e-5 of
numbers of about 1 after some layers), are given no weight in the comparison."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """Anchors and networks drawn from a seed."""

    sizes: HierarchySettings
    anchors: MotionAnchors
    shared: dict[str, Tensor]
    index: Tensor | None

    @property
    def networks(self) -> HierarchyNetworks:
        return nets.hierarchy(self.shared, self.sizes.layers)

    def rows(self) -> dict[str, Tensor]:
        """The stored tensors that decoding reads."""
        found = {n: v for n, v in vars(self.anchors).items() if isinstance(v, Tensor)}
        del found["quaternions"]
        return found | {f"offsets{i}": v for i, v in enumerate(self.anchors.offsets, start=1)}

    def tensors(self) -> dict[str, Tensor]:
        """Everything that gets a gradient, by name."""
        return self.rows() | self.shared


def drawn(
    n: int, layers: int, k: int, leaf: int, seed: int, *, f=8, h=3, share=1.0, wide=0.3, period=1.0
) -> Case:
    """Random anchors and networks, all residuals and spans at work."""
    sizes = by_leaf(
        HierarchySettings(layers=layers, children=k, features=f, instance=h, period=period), leaf
    )
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=g)
    shared = nets.drawn(sizes, seed, ice=False)
    shared = {
        name: 0.5 * draw(*v.shape) / max(1, v[..., 0].numel()) ** 0.5 for name, v in shared.items()
    }
    counts = [k**layer for layer in range(1, layers - 1)] + [sizes.gaussians]
    anchors = MotionAnchors(
        centres=draw(n, 3), features=draw(n, f), instances=draw(n, h), quaternions=draw(n, 4),
        log_scales=wide * draw(n, 3), peaks=draw(n), velocities=draw(n, 3), log_spans=0.3 * draw(n),
        offsets=tuple(draw(n, count, 3) for count in counts),
    )  # fmt: skip
    index = torch.where(torch.rand(n, generator=g) < share)[0] if share < 1 else None
    return Case(sizes=sizes, anchors=anchors, shared=shared, index=index)


def changed(case: Case, change, rows=None) -> Case:
    """A case whose tensors are changed; of the anchors only some rows, if so said."""
    of = lambda value: change(value if rows is None else value[rows])
    parts = {n: of(v) for n, v in vars(case.anchors).items() if isinstance(v, Tensor)}
    anchors = MotionAnchors(**parts, offsets=tuple(map(of, case.anchors.offsets)))
    return replace(case, anchors=anchors, shared={n: change(v) for n, v in case.shared.items()})


def of_reference(case: Case) -> Case:
    """The same numbers in float64, only those of the index."""
    return replace(changed(case, Tensor.double, case.index), index=None)


def calm(case: Case) -> Tensor:
    """Whether rounding decides nothing about an anchor, from the float64 case."""
    far = torch.ones(len(case.anchors.peaks), dtype=torch.bool)
    evaluate = mlp.evaluate

    def watched(network, inputs):
        units = (inputs @ network.weights[0] + network.biases[0]).abs() > NEAR
        if len(far):
            far.logical_and_(units.reshape(len(far), -1).all(dim=1))
        return evaluate(network, inputs)

    with pytest.MonkeyPatch.context() as patch, torch.no_grad():
        patch.setattr(motion_hierarchy.mlp, "evaluate", watched)
        motion_hierarchy.decode(
            case.anchors, case.networks, case.sizes, TIME, CAMERA.to(case.anchors.peaks)
        )
    return far


def outputs(splats: Splats) -> dict[str, Tensor]:
    """What was decoded; quaternions of norm 1."""
    found = {name: getattr(splats, name) for name in VALUES}
    found["quaternions"] = rotation.normalise(found["quaternions"])
    return {name: value.reshape(-1, VALUES[name]) for name, value in found.items()}


def gradients(case: Case, decoded: dict[str, Tensor], weights: dict[str, Tensor]) -> dict:
    leaves = case.tensors()
    loss = torch.stack([(v * weights[n].to(v)).sum() for n, v in decoded.items()]).sum()
    found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
    return {
        name: torch.zeros_like(leaf) if value is None else value
        for (name, leaf), value in zip(leaves.items(), found, strict=True)
    }


def compare(case: Case, seed: int = 0, only: str | None = None) -> dict[str, float]:
    """Errors: of each decoded number as a share of it, of a gradient as a share of the tensor's largest.

    Both are absolute below 1, the size of the weights of the loss.

    Args:
        case: What is decoded.
        seed: Of the loss's weights.
        only: Name of the one output that the loss reads; None: all.
    """
    truth = of_reference(case)
    k = case.sizes.gaussians
    rows = torch.arange(len(case.anchors.peaks)) if case.index is None else case.index
    held = calm(truth).repeat_interleave(k)[:, None]
    for leaf in [*truth.tensors().values(), *case.tensors().values()]:
        leaf.requires_grad_(True)
    want = outputs(
        motion_hierarchy.decode(truth.anchors, truth.networks, case.sizes, TIME, CAMERA.double())
    )
    splats = native.decode(case.anchors, case.networks, case.sizes, TIME, CAMERA, index=case.index)
    assert splats.rows is not None
    assert splats.slots is not None
    assert torch.equal(splats.rows, rows.repeat_interleave(k))
    assert torch.equal(splats.slots, (rows[:, None] * k + torch.arange(k)).flatten())
    got = outputs(splats)
    g = torch.Generator().manual_seed(seed)
    weights = {
        name: torch.randn(len(rows) * k, width, generator=g) * held * (only in (None, name))
        for name, width in VALUES.items()
    }
    errors = {}
    for name, value in want.items():
        apart = ((got[name].double() - value) * held).detach().abs()
        share = apart / value.detach().abs().clamp(min=1)
        errors[name] = float(share.max()) if len(apart) else 0.0
    exact, found = gradients(truth, want, weights), gradients(case, got, weights)
    for name, value in exact.items():
        mine = found[name].double()
        if case.index is not None and name in case.rows():
            out = torch.ones(len(mine), dtype=torch.bool).index_fill(0, case.index, False)
            assert not mine[out].any(), name
            mine = mine[case.index]
        size = float(value.abs().max()) if value.numel() else 0.0
        apart = float((mine - value).abs().max()) if value.numel() else 0.0
        errors[f"by {name}"] = apart / max(size, 1.0)
    return errors


shapes = st.fixed_dictionaries({
    "n": st.integers(1, 70), "layers": st.integers(2, 5), "k": st.integers(1, 3),
    "leaf": st.integers(1, 7), "f": st.sampled_from([1, 4, 15, 16, 17, 32]),
    "h": st.sampled_from([1, 3, 8]), "seed": st.integers(0, 2**20),
    "share": st.sampled_from([0.0, 0.5, 0.9, 1.0]), "period": st.sampled_from([0.2, 1.0, 30.0]),
})  # fmt: skip

OUTPUTS, GRADIENTS = 3e-5, 2e-4
"""Bounds of `compare`; see `test_it_is_the_references_decode`."""


def check(errors: dict[str, float]) -> None:
    """Every error is within its bound."""
    for name, error in errors.items():
        assert error <= (GRADIENTS if name.startswith("by ") else OUTPUTS), f"{name}: {error}"


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(shape=shapes)
def test_it_is_the_references_decode(simd_level, shape):
    check(compare(drawn(**shape)))


@pytest.mark.parametrize("layers", [2, 3, 4])
def test_many_anchors_whose_gradients_are_added_in_parts(simd_level, layers):
    check(compare(drawn(500, layers, 2, 6, 5, f=32, h=8, share=0.9)))


HARD = {
    "one anchor": drawn(1, 3, 2, 6, 1),
    "one Gaussian an anchor": drawn(40, 2, 2, 1, 2),
    "none in view": drawn(30, 3, 2, 3, 3, share=0.0),
    "no anchor": drawn(0, 3, 2, 3, 4),
    "widths of odd numbers": drawn(33, 4, 3, 5, 5, f=13, h=5),
    "one child": drawn(33, 5, 1, 2, 6),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_cases(simd_level, name):
    check(compare(HARD[name]))


def test_a_camera_in_an_anchor(simd_level):
    case = drawn(20, 2, 2, 5, 8)
    case.anchors.centres[7] = CAMERA
    case.anchors.velocities[7] = 0
    errors = compare(case)
    check(errors)


@pytest.mark.parametrize("name", VALUES)
def test_each_output_alone_passes_its_gradient_on(simd_level, name):
    check(compare(drawn(60, 3, 2, 5, 9, f=16), only=name))


def test_waves_are_exact_over_their_range(simd_level):
    """Anchors at rest: what a residual network of one unit reads of their code, with positions near and far."""
    ends = torch.tensor([0.0, 1e-30, 1e-4, 0.7853981, 0.7853983, 1.5707963, 3.1415927, 100.0, 1e5])
    grid = torch.cat([-ends, ends, torch.linspace(-9, 9, 2001)])
    n = len(grid)
    case = drawn(n, 2, 1, 1, 0, f=1, h=1)
    anchors = changed(case, torch.zeros_like).anchors
    anchors.centres[:] = grid[:, None]
    for octave in range(4):
        for part, wave in enumerate((torch.sin, torch.cos)):
            shared = {name: torch.zeros_like(v) for name, v in case.shared.items()}
            shared["leaf_position.weight0"][1 + 3 + 6 * octave + 3 * part] = 1
            shared["leaf_position.bias0"][:] = 2  # above the bend
            shared["leaf_position.weight1"][0] = 1
            splats = native.decode(anchors, nets.hierarchy(shared, 2), case.sizes, TIME, CAMERA)
            want = wave(grid.double() * 2**octave) + 2 + grid.double()
            found = splats.means[:, 0].double()
            # the sum with a far position is rounded to that position's last place
            assert ((found - want).abs() <= 2e-6 + 2e-7 * grid.abs()).all()


def test_bits_do_not_depend_on_threads():
    case = drawn(1500, 3, 2, 6, 11, f=20, share=0.8)
    leaves = [leaf.requires_grad_() for leaf in case.tensors().values()]
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            splats = native.decode(
                case.anchors, case.networks, case.sizes, TIME, CAMERA, index=case.index
            )
            facts = (case.anchors, case.networks, case.sizes, TIME, looking(case, 1))
            visible = native.visible(*facts, index=case.index)
            values = [getattr(splats, name) for name in VALUES]
            loss = torch.cat([value.flatten() for value in values]).cos().sum()
            found.append([visible, *values, *torch.autograd.grad(loss, leaves)])
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def looking(case: Case, seed: int) -> native.Pyramid:
    """A pyramid of 40 degrees from a little off the anchors towards one of them."""
    draw = np.random.default_rng(seed)
    turn = Rotation.from_quat(draw.normal(size=4)).as_matrix()
    target = case.anchors.centres[draw.integers(len(case.anchors.centres))].detach().numpy()
    shift = [0, 0, 1.5] - turn @ target
    sides = np.array([[1, 0, 0.36], [-1, 0, 0.36], [0, 1, 0.36], [0, -1, 0.36]])
    return native.Pyramid(
        pose=torch.tensor(np.hstack([turn, shift[:, None]]), dtype=torch.float32), near=0.2,
        sides=torch.tensor(sides / np.linalg.norm(sides, axis=1, keepdims=True), dtype=torch.float32),
        sigmas=3.3, blur=0.02,
    )  # fmt: skip


def small(case: Case) -> Case:
    """The anchors a twelfth in size, so that pyramids leave some out."""
    anchors = replace(case.anchors, log_scales=case.anchors.log_scales - 2.5)
    return replace(case, anchors=anchors)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("layers", [2, 3, 4])
def test_visible_is_the_twins(simd_level, layers, moves):
    case, some = small(drawn(45, layers, 2, 4, 12, share=0.7)), 0
    assert case.index is not None
    for seed in range(6):
        pyramid = looking(case, seed)
        drift = torch.randn(len(case.index), 3, generator=torch.Generator().manual_seed(seed))
        drift = drift if moves else None
        facts = (case.networks, case.sizes, TIME)
        found = native.visible(case.anchors, *facts, pyramid, index=case.index, drift=drift)
        wide = changed(case, Tensor.double)
        # a hair to either side: what lies between the two may fall to either
        less, more = (
            twin.visible(
                wide.anchors, wide.networks, case.sizes, TIME, case.index,
                replace(pyramid, sigmas=pyramid.sigmas * by, near=pyramid.near / by), drift,
            )
            for by in (1 - 1e-5, 1 + 1e-5)
        )  # fmt: skip
        assert not (less & ~found).any()
        assert not (found & ~more).any()
        some += int(found.sum())
    assert 0 < some < 6 * len(case.index)


@pytest.mark.parametrize("layers", [2, 3, 4])
def test_what_is_not_visible_decodes_to_nothing_within_the_pyramid(layers):
    case = small(drawn(200, layers, 2, 4, 12))
    pyramid = looking(case, 0)
    found = native.visible(case.anchors, case.networks, case.sizes, TIME, pyramid)
    splats = native.decode(case.anchors, case.networks, case.sizes, TIME, CAMERA)
    local = splats.means @ pyramid.pose[:, :3].T + pyramid.pose[:, 3]
    reach = pyramid.sigmas * splats.scales.amax(dim=1) + pyramid.blur * local[:, 2].abs()
    within = (local[:, 2] > pyramid.near) & (local @ pyramid.sides.T > -reach[:, None]).all(dim=1)
    assert splats.rows is not None
    shown = torch.zeros(len(found), dtype=torch.bool)
    shown[splats.rows[within]] = True
    assert not (shown & ~found).any()
    assert 0 < int(shown.sum()) < len(found)


@pytest.mark.parametrize("layers", [2, 3])
def test_features_of_the_decoded_anchors_alone(layers):
    case = drawn(40, layers, 2, 3, 12, share=0.5)
    assert case.index is not None
    features = torch.randn(len(case.index), 8, generator=torch.Generator().manual_seed(0))
    stored = case.anchors.features.clone()
    stored[case.index] = features
    features.requires_grad_()
    stored.requires_grad_()
    facts = (case.networks, case.sizes, TIME, CAMERA)
    got = native.decode(case.anchors, *facts, index=case.index, features=features)
    want = native.decode(replace(case.anchors, features=stored), *facts, index=case.index)
    got, want = outputs(got)["colours"], outputs(want)["colours"]
    assert torch.equal(got, want)
    got.cos().sum().backward()
    want.cos().sum().backward()
    assert features.grad is not None
    assert stored.grad is not None
    assert torch.equal(features.grad, stored.grad[case.index])


@pytest.mark.parametrize("name", ["offsets1", "features", "peaks", "colour.weight0"])
def test_what_is_frozen_gets_no_gradient_and_changes_none(name):
    case = drawn(50, 3, 2, 4, 13)

    def loss() -> Tensor:
        splats = native.decode(case.anchors, case.networks, case.sizes, TIME, CAMERA)
        return sum((value.cos().sum() for value in outputs(splats).values()), torch.zeros(()))

    leaf = case.tensors()[name].requires_grad_()
    (alone,) = torch.autograd.grad(loss(), [leaf])
    for other in case.tensors().values():
        other.requires_grad_()
    (among,) = torch.autograd.grad(loss(), [leaf])
    assert torch.equal(alone, among)


def test_a_frame_scales_and_moves_what_is_decoded(simd_level):
    case = drawn(40, 3, 2, 3, 18)
    leaves = [leaf.requires_grad_() for leaf in case.tensors().values()]
    facts = (case.anchors, case.networks, case.sizes, TIME, CAMERA)
    plain, moved = (
        native.decode(*facts),
        native.decode(*facts, unit=4.0, middle=(1.0, -2.0, 30.0)),
    )
    torch.testing.assert_close(moved.means, plain.means * 4 + torch.tensor([1.0, -2.0, 30.0]))
    torch.testing.assert_close(moved.scales, plain.scales * 4)
    want, found = (
        torch.autograd.grad(loss, leaves, allow_unused=True)
        for loss in (4 * plain.means.sum() + (4 * plain.scales).square().sum(),
                     moved.means.sum() + moved.scales.square().sum())
    )  # fmt: skip
    for one, other in zip(want, found, strict=True):
        assert one is not None
        torch.testing.assert_close(other, one, rtol=1e-4, atol=1e-4 * float(one.abs().max()))


def test_a_value_that_is_no_number_stays_one_and_stays_with_its_anchor():
    case = drawn(40, 3, 2, 3, 14)
    decode = lambda: outputs(native.decode(case.anchors, case.networks, case.sizes, TIME, CAMERA))
    want = decode()
    case.anchors.features[5] = torch.nan
    case.anchors.log_scales[9] = torch.nan
    found = decode()
    k = case.sizes.gaussians
    hit = torch.arange(40).repeat_interleave(k)
    assert found["colours"][hit == 5].isnan().all()
    assert found["scales"][hit == 9].isnan().all()
    assert found["means"][hit == 9].isnan().all()
    others = (hit != 5) & (hit != 9)
    assert all(torch.equal(found[name][others], want[name][others]) for name in VALUES)


def test_a_wrong_gradient_is_seen():
    """The comparison itself: an error of any number fails it."""
    errors = compare(drawn(40, 3, 2, 3, 15))
    check(errors)
    assert {f"by {name}" for name in drawn(1, 3, 2, 3, 0).tensors()} <= set(errors)
    for name in errors:
        with pytest.raises(AssertionError, match=name):
            check({**errors, name: 1e-3})


def with_anchors(case: Case, **parts: Any) -> Case:
    return replace(case, anchors=replace(case.anchors, **parts))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: with_anchors(c, centres=c.anchors.centres.double()), "float32"),
        (lambda c: replace(c, shared=drawn(1, 3, 2, 3, 0, h=4).shared), "first layer"),
        (lambda c: replace(c, shared=drawn(1, 3, 2, 4, 0).shared), "second layer"),
        (lambda c: replace(c, sizes=replace(c.sizes, gaussians=7)), "number of Gaussians"),
        (lambda c: replace(c, sizes=replace(c.sizes, period=0.0)), "period"),
        (lambda c: replace(c, sizes=replace(c.sizes, children=3)), "Gaussians|offsets"),
        (lambda c: replace(c, index=torch.tensor([3, 2])), r"index\[1\] is 2"),
        (lambda c: replace(c, index=torch.tensor([3, 40])), r"index\[1\] is 40"),
        (lambda c: replace(c, index=torch.tensor([-1, 4])), r"index\[0\] is -1"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(change, message):
    case = change(drawn(40, 3, 2, 3, 16))
    with pytest.raises(ValueError, match=message):
        native.decode(case.anchors, case.networks, case.sizes, TIME, CAMERA, index=case.index)


def test_what_the_kernels_cannot_do_is_left_to_the_twin():
    case = drawn(5, 3, 2, 3, 17)
    assert native.applies(case.anchors, case.networks, CAMERA)
    deep = mlp.create((12, 8, 8, 9), torch.Generator().manual_seed(0))
    assert not native.applies(case.anchors, replace(case.networks, colour=deep), CAMERA)
    assert not native.applies(case.anchors, case.networks, CAMERA.clone().requires_grad_())
    exact = of_reference(case)
    assert not native.applies(exact.anchors, exact.networks, CAMERA)
    many = drawn(2, native.MOST_LAYERS + 1, 1, 1, 0)
    assert not native.applies(many.anchors, many.networks, CAMERA)
    few = drawn(2, native.MOST_LAYERS, 1, 1, 0)
    assert native.applies(few.anchors, few.networks, CAMERA)
    check(compare(few))
