"""The native decoding of anchors against the reference in float64: what is decoded, and every gradient."""

from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof.methods.kernels import anchors as native
from splatproof.reference.anchors import scaffold
from splatproof.reference.anchors.scaffold import Anchors, Decoder
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats

VALUES = {"means": 3, "quaternions": 4, "scales": 3, "opacities": 1, "colours": 3}
"""What is decoded for each slot, and how many numbers of it."""
CAMERA = torch.tensor([0.3, -0.2, 0.5])
NEAR = 1e-4
"""Anchors with a unit or an opacity this close to the bend or end of its activation, where rounding decides (float32
leaves 1e-6 of numbers of about 1), are given no weight in the comparison."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """Anchors and networks drawn from a seed."""

    anchors: Anchors
    decoder: Decoder
    index: Tensor | None
    with_distance: bool

    def tensors(self) -> dict[str, Tensor]:
        """Everything that gets a gradient, by name."""
        found = dict(vars(self.anchors))
        for name, network in vars(self.decoder).items():
            parts = zip(network.weights, network.biases, strict=True)
            for i, (weight, bias) in enumerate(parts):
                found |= {f"{name}.weight{i}": weight, f"{name}.bias{i}": bias}
        return found


def drawn(
    n: int, k: int, f: int, seed: int, *, with_distance=False, hidden=(0, 0, 0), share=1.0, wide=1.0
) -> Case:
    """Features and biases of about 1; `hidden` beyond the width of the features."""
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=g)
    extra = 4 if with_distance else 3
    outputs = {"opacity": k, "shape": 7 * k, "colour": 3 * k}
    networks = {}
    for (name, width), more in zip(outputs.items(), hidden, strict=True):
        made = mlp.create((f + extra, f + more, width), g)
        networks[name] = Mlp(
            weights=made.weights, biases=tuple(0.3 * draw(*b.shape) for b in made.biases)
        )
    anchors = Anchors(
        centres=3 * draw(n, 3), offsets=draw(n, k, 3), features=draw(n, f),
        log_scales=wide * draw(n, 6),
    )  # fmt: skip
    index = torch.where(torch.rand(n, generator=g) < share)[0] if share < 1 else None
    return Case(
        anchors=anchors, decoder=Decoder(**networks), index=index, with_distance=with_distance
    )


def of_reference(case: Case) -> Case:
    """The same numbers in float64, only those of the index."""
    chosen = slice(None) if case.index is None else case.index
    parts = {name: value.double()[chosen] for name, value in vars(case.anchors).items()}
    networks = {
        name: mlp.change(network, torch.Tensor.double)
        for name, network in vars(case.decoder).items()
    }
    return replace(case, anchors=Anchors(**parts), decoder=Decoder(**networks), index=None)


def calm(case: Case) -> Tensor:
    """Whether rounding decides nothing about an anchor, from the float64 case."""
    direction, distance = scaffold.view_code(case.anchors.centres, CAMERA)
    extra = [direction, distance] if case.with_distance else [direction]
    code = torch.cat([case.anchors.features, *extra], dim=1)
    far = torch.ones(len(code), dtype=torch.bool)
    for network in vars(case.decoder).values():
        units = code @ network.weights[0] + network.biases[0]
        far &= (units.abs() > NEAR).all(dim=1)
    opacities = mlp.evaluate(case.decoder.opacity, code)
    return far & (opacities.abs() > NEAR).all(dim=1)


def spread(splats: Splats, slots: int) -> dict[str, Tensor]:
    """What was decoded at its slot, 0 elsewhere."""
    assert splats.slots is not None
    found = {}
    for name, width in VALUES.items():
        value = getattr(splats, name).reshape(-1, width)
        found[name] = value.new_zeros(slots, width).index_put((splats.slots,), value)
    return found


def gradients(case: Case, decoded: dict[str, Tensor], leaves: dict[str, Tensor], weights) -> dict:
    loss = torch.stack([(v * weights[n].to(v)).sum() for n, v in decoded.items()]).sum()
    if not loss.requires_grad:
        return {name: torch.zeros_like(leaf) for name, leaf in leaves.items()}
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
    k = case.anchors.offsets.shape[1]
    quiet = calm(truth)
    rows = torch.arange(len(case.anchors.centres)) if case.index is None else case.index
    for leaf in [*truth.tensors().values(), *case.tensors().values()]:
        leaf.requires_grad_(True)
    want = spread(
        scaffold.decode(
            truth.anchors, truth.decoder, CAMERA.double(), with_distance=case.with_distance
        ),
        len(rows) * k,
    )
    splats = native.decode(
        case.anchors, case.decoder, CAMERA, with_distance=case.with_distance, index=case.index
    )
    assert splats.rows is not None
    assert splats.slots is not None
    assert torch.equal(splats.rows, splats.slots // k)
    everywhere = spread(splats, len(case.anchors.centres) * k)
    slots = (rows[:, None] * k + torch.arange(k)).flatten()
    assert all((value.detach() != 0).sum() == (value.detach()[slots] != 0).sum()
               for value in everywhere.values())  # fmt: skip
    got = {name: value[slots] for name, value in everywhere.items()}
    g = torch.Generator().manual_seed(seed)
    held = quiet.repeat_interleave(k)[:, None]
    weights = {
        name: torch.randn(len(slots), width, generator=g) * held * (only in (None, name))
        for name, width in VALUES.items()
    }
    errors = {}
    for name, value in want.items():
        apart = ((got[name].double() - value) * held).detach().abs()
        errors[name] = (
            float((apart / value.detach().abs().clamp(min=1)).max()) if len(apart) else 0.0
        )
    exact = gradients(truth, want, truth.tensors(), weights)
    found = gradients(case, got, case.tensors(), weights)
    for name, value in exact.items():
        mine = found[name].double()
        if case.index is not None and name in vars(case.anchors):
            out = torch.ones(len(mine), dtype=torch.bool).index_fill(0, case.index, False)
            assert not mine[out].any(), name
            mine = mine[case.index]
        size = float(value.detach().abs().max()) if value.numel() else 0.0
        apart = float((mine - value).abs().max()) if value.numel() else 0.0
        errors[f"by {name}"] = apart / max(size, 1.0)
    return errors


shapes = st.fixed_dictionaries({
    "n": st.integers(1, 80), "k": st.integers(1, 11),
    "f": st.sampled_from([1, 4, 15, 16, 17, 32, 33]), "seed": st.integers(0, 2**20),
    "with_distance": st.booleans(), "hidden": st.tuples(*[st.integers(0, 18)] * 3),
    "share": st.sampled_from([0.0, 0.5, 0.9, 1.0]),
})  # fmt: skip


OUTPUTS, GRADIENTS = 1e-5, 3e-5
"""Bounds of `compare`. Over 1,000 cases at all SIMD levels the largest errors were 1.7e-6 (a quaternion that was short
before it was normalised) and 4.2e-6 (sums that nearly cancel); the medians are 1e-7."""


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


@pytest.mark.parametrize("with_distance", [False, True])
def test_many_anchors_whose_gradients_are_added_in_parts(simd_level, with_distance):
    check(compare(drawn(700, 10, 32, 5, with_distance=with_distance, share=0.9)))


HARD = {
    "one anchor": drawn(1, 10, 32, 1),
    "one Gaussian an anchor": drawn(40, 1, 32, 2, with_distance=True),
    "none in view": drawn(30, 3, 8, 3, share=0.0),
    "no anchor": drawn(0, 3, 8, 4),
    "widths of odd numbers": drawn(33, 7, 13, 5, hidden=(2, 11, 5)),
    "scales from 1e-35 to 1e35": drawn(40, 4, 8, 7, wide=20.0),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_cases(simd_level, name):
    check(compare(HARD[name]))


def test_nothing_opaque_is_nothing_decoded(simd_level):
    case = drawn(50, 4, 8, 6)
    shut = mlp.change(case.decoder.opacity, lambda t: t - 9 if t.shape == (4,) else t)
    case = replace(case, decoder=replace(case.decoder, opacity=shut))
    splats = native.decode(case.anchors, case.decoder, CAMERA)
    assert len(splats) == 0
    check(compare(case))


@pytest.mark.parametrize("with_distance", [False, True])
def test_a_camera_in_an_anchor(simd_level, with_distance):
    case = drawn(20, 5, 8, 8, with_distance=with_distance)
    case.anchors.centres[7] = CAMERA
    check(compare(case))


@pytest.mark.parametrize("name", VALUES)
def test_each_output_alone_passes_its_gradient_on(simd_level, name):
    check(compare(drawn(60, 5, 16, 9, with_distance=True), only=name))


def test_a_quaternion_of_zero_is_the_identity_without_gradient():
    case = drawn(3, 2, 4, 0)
    still = mlp.change(case.decoder.shape, torch.zeros_like)
    open_ = mlp.change(case.decoder.opacity, torch.ones_like)
    case = replace(case, decoder=replace(case.decoder, shape=still, opacity=open_))
    bias = still.biases[1].requires_grad_()
    anchors = replace(case.anchors, features=case.anchors.features.abs())
    splats = native.decode(anchors, case.decoder, CAMERA - 100)
    assert len(splats) == 6
    assert torch.equal(splats.quaternions, torch.tensor([1.0, 0, 0, 0]).expand(6, 4))
    splats.quaternions.square().sum().backward()
    assert bias.grad is not None
    assert not bias.grad.any()


def test_activations_are_exact_over_their_range(simd_level):
    """One anchor whose slots, and many anchors whose scales, are a grid of arguments."""
    ends = torch.tensor([1e-30, 1e-10, 1e-4, 0.4999, 0.5, 20, 90, 1e4, 1e30])
    grid = torch.cat([-ends, ends, torch.linspace(-12, 12, 2001)])
    k = len(grid)
    flat = {
        name: Mlp(
            weights=(torch.zeros(4, 1), torch.zeros(1, width)),
            biases=(torch.zeros(1), bias),
        )
        for name, width, bias in (
            ("opacity", k, grid), ("shape", 7 * k, torch.zeros(7 * k)),
            ("colour", 3 * k, grid.repeat_interleave(3)),
        )
    }  # fmt: skip
    flat["shape"].biases[1].view(k, 7)[:, :3] = grid[:, None]
    anchors = Anchors(
        centres=torch.zeros(1, 3), offsets=torch.zeros(1, k, 3), features=torch.zeros(1, 1),
        log_scales=torch.zeros(1, 6),
    )  # fmt: skip
    splats = native.decode(anchors, Decoder(**flat), CAMERA)
    assert splats.slots is not None
    assert torch.equal(splats.slots, torch.where(grid > 0)[0])
    exact = grid[grid > 0].double()
    close(splats.opacities, exact.tanh())
    close(colours_of(splats)[:, 0], exact.sigmoid())
    upside = {name: mlp.change(network, torch.neg) for name, network in flat.items()}
    upside["opacity"] = flat["opacity"]
    down = native.decode(anchors, Decoder(**upside), CAMERA)
    close(colours_of(down)[:, 1], (-exact).sigmoid())
    close(down.scales[:, 2], (-exact).sigmoid())
    sizes = torch.cat([torch.linspace(-87, 88.7, 4001), torch.tensor([0.0, -120, -1e4, 89, 1e4])])
    one = drawn(len(sizes), 1, 1, 0)
    open_ = mlp.change(one.decoder.opacity, lambda t: torch.zeros_like(t) + (t.ndim == 1))
    anchors = replace(
        one.anchors, centres=0 * one.anchors.centres, offsets=one.anchors.offsets.new_ones(len(sizes), 1, 3),
        log_scales=sizes[:, None].repeat(1, 6),
    )  # fmt: skip
    splats = native.decode(anchors, replace(one.decoder, opacity=open_), CAMERA)
    assert len(splats) == len(sizes)
    close(splats.means[:, 0], sizes.double().exp().float())


def colours_of(splats: Splats) -> Tensor:
    assert splats.colours is not None
    return splats.colours


def close(found: Tensor, exact: Tensor) -> None:
    """Within 4e-7 of each number (measured: 2e-7, three units of the last place); below 1e-37 float32 has none."""
    torch.testing.assert_close(found.double(), exact.double(), rtol=4e-7, atol=1e-37)


def test_bits_do_not_depend_on_threads():
    case = drawn(1500, 6, 20, 11, share=0.8)
    leaves = [leaf.requires_grad_() for leaf in case.tensors().values()]
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            splats = native.decode(case.anchors, case.decoder, CAMERA, index=case.index)
            values = [getattr(splats, name) for name in VALUES]
            loss = torch.cat([value.flatten() for value in values]).cos().sum()
            found.append([*values, *torch.autograd.grad(loss, leaves)])
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_features_of_the_decoded_anchors_alone():
    case = drawn(40, 3, 8, 12, share=0.5)
    assert case.index is not None
    features = torch.randn(len(case.index), 8, generator=torch.Generator().manual_seed(0))
    stored = case.anchors.features.clone()
    stored[case.index] = features
    features.requires_grad_()
    stored.requires_grad_()
    got = native.decode(case.anchors, case.decoder, CAMERA, index=case.index, features=features)
    want = native.decode(
        replace(case.anchors, features=stored), case.decoder, CAMERA, index=case.index
    )
    assert torch.equal(colours_of(got), colours_of(want))
    colours_of(got).cos().sum().backward()
    colours_of(want).cos().sum().backward()
    assert features.grad is not None
    assert stored.grad is not None
    assert torch.equal(features.grad, stored.grad[case.index])


def test_what_is_frozen_gets_no_gradient_and_changes_none():
    case = drawn(50, 4, 16, 13)
    case.anchors.offsets.requires_grad_()
    native.decode(case.anchors, case.decoder, CAMERA).means.cos().sum().backward()
    alone = case.anchors.offsets.grad
    case.anchors.offsets.grad = None
    for leaf in case.tensors().values():
        leaf.requires_grad_()
    native.decode(case.anchors, case.decoder, CAMERA).means.cos().sum().backward()
    assert alone is not None
    assert case.anchors.offsets.grad is not None
    assert torch.equal(alone, case.anchors.offsets.grad)


def test_a_value_that_is_no_number_stays_one_and_stays_with_its_anchor():
    case = drawn(40, 3, 8, 14)
    want = native.decode(case.anchors, case.decoder, CAMERA)
    assert want.rows is not None
    one, other = want.rows.unique()[:2].tolist()
    case.anchors.log_scales[one] = torch.nan
    found = native.decode(case.anchors, case.decoder, CAMERA)
    assert found.rows is not None
    hit = found.rows == one
    assert found.means[hit].isnan().all()
    assert found.scales[hit].isnan().all()
    assert torch.equal(found.means[~hit], want.means[~hit])
    case.anchors.features[other] = torch.nan
    found = native.decode(case.anchors, case.decoder, CAMERA)
    assert found.rows is not None
    assert torch.equal(found.rows, want.rows[want.rows != other])
    shape = mlp.change(case.decoder.shape, lambda t: torch.full_like(t, torch.nan))
    found = native.decode(case.anchors, replace(case.decoder, shape=shape), CAMERA)
    assert found.quaternions.isnan().all()
    assert found.scales.isnan().all()


def test_a_wrong_gradient_is_seen():
    """The comparison itself: a decode whose colours forget a network's bias fails it."""
    case = drawn(40, 3, 8, 15)
    errors = compare(case)
    check(errors)
    for name in errors:
        with pytest.raises(AssertionError, match=name):
            check({**errors, name: 1e-4})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: replace(c, anchors=replace(c.anchors, centres=c.anchors.centres.double())), "float32"),
        (lambda c: replace(c, decoder=scaffold.create_decoder(9, 3, torch.Generator())), "first layer"),
        (lambda c: replace(c, decoder=scaffold.create_decoder(8, 2, torch.Generator())), "second layer"),
        (lambda c: replace(c, index=torch.tensor([3, 2])), r"index\[1\] is 2"),
        (lambda c: replace(c, index=torch.tensor([3, 40])), r"index\[1\] is 40"),
        (lambda c: replace(c, index=torch.tensor([-1, 4])), r"index\[0\] is -1"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(change, message):
    case = change(drawn(40, 3, 8, 16))
    with pytest.raises(ValueError, match=message):
        native.decode(case.anchors, case.decoder, CAMERA, index=case.index)


def test_what_the_kernels_cannot_do_is_left_to_the_reference():
    case = drawn(5, 3, 8, 17)
    assert native.applies(case.anchors, case.decoder, CAMERA)
    deep = mlp.create((11, 8, 8, 3), torch.Generator().manual_seed(0))
    assert not native.applies(case.anchors, replace(case.decoder, opacity=deep), CAMERA)
    assert not native.applies(case.anchors, case.decoder, CAMERA.clone().requires_grad_())
    exact = of_reference(case)
    assert not native.applies(exact.anchors, exact.decoder, CAMERA)
