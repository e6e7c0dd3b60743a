"""The native consistency step against its torch twin in float64: features, and every gradient."""

from dataclasses import replace

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from splatproof.methods.hdgs.consistency import Ice, Pairs, pairs, supported_by_products
from splatproof.methods.kernels import support as native
from splatproof.reference.anchors import support_network
from splatproof.reference.anchors.support_network import SupportNetwork
from splatproof.reference.types import mlp

PARTS: dict[Ice, tuple[bool, bool]] = {"full": (True, True), "no-mod": (False, True), "no-gate": (True, False),
         "conv": (False, False)}  # fmt: skip
"""Whether the step is modulated and gated."""
BOUND = 5e-5
"""Of errors as a share of the tensor's largest, absolute below 1."""


Case = tuple[SupportNetwork, dict[str, Tensor], Pairs, Tensor]


def drawn(n: int, c: int, seed: int, *, share: float = 0.7, edge: int = 5) -> Case:
    """Sites in a cube, all networks at work, and whose features are asked for."""
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=g)
    cells = torch.randperm(edge**3, generator=g)[:n]
    corner = torch.stack([cells // edge**2, cells // edge % edge, cells % edge], dim=1)
    centres = corner + 0.05 + 0.9 * torch.rand(len(cells), 3, generator=g)
    near = lambda t: t + 0.3 * draw(*t.shape)
    made = support_network.create(c, g, torch.float32)
    network = SupportNetwork(
        convolution=near(made.convolution), modulation=mlp.change(made.modulation, near),
        residual=mlp.change(made.residual, near), gate=mlp.change(made.gate, near),
    )  # fmt: skip
    count = len(cells)
    sites = {
        "features": draw(count, c), "centres": centres, "quaternions": draw(count, 4),
        "scales": draw(count, 3).exp(),
    }  # fmt: skip
    wanted = torch.rand(count, generator=g) < share
    return network, sites, pairs(centres, 1.0), torch.where(wanted)[0]


def exact(case: Case) -> Case:
    network, sites, near, seen = case
    parts = {
        name: mlp.change(getattr(network, name), Tensor.double)
        for name in ("modulation", "residual", "gate")
    }
    network = SupportNetwork(convolution=network.convolution.double(), **parts)
    return network, {name: value.double() for name, value in sites.items()}, near, seen


def leaves(case: Case) -> dict[str, Tensor]:
    """Everything that gets a gradient, by name."""
    network, sites, _, _ = case
    found = {"convolution": network.convolution} | {
        name: value for name, value in sites.items() if name != "centres"
    }
    for name in ("modulation", "residual", "gate"):
        net = getattr(network, name)
        for i, (weight, bias) in enumerate(zip(net.weights, net.biases, strict=True)):
            found |= {f"{name}.weight{i}": weight, f"{name}.bias{i}": bias}
    return found


def run(case: Case, parts: Ice) -> Tensor:
    """By the kernels."""
    network, sites, near, seen = case
    modulated, gated = PARTS[parts]
    return native.support(
        network, sites["features"], sites["centres"], sites["quaternions"], sites["scales"],
        (near.sites, near.neighbours, near.ends), seen, modulated=modulated, gated=gated,
    )  # fmt: skip


def run_twin(case: Case, parts: Ice) -> Tensor:
    """By torch."""
    network, sites, near, seen = case
    wanted = torch.zeros(len(sites["centres"]), dtype=torch.bool)
    wanted[seen] = True
    return supported_by_products(
        network, sites["features"], sites["centres"], sites["quaternions"], sites["scales"],
        near.of(wanted), seen, parts,
    )  # fmt: skip


def errors(case: Case, parts: Ice) -> dict[str, float]:
    """Of the features and of each gradient, as a share of the largest."""
    truth = exact(case)
    outcomes = []
    for this, call in (
        (truth, lambda c: run_twin(c, parts)),
        (case, lambda c: run(c, parts)),
    ):
        held = leaves(this)
        for leaf in held.values():
            leaf.requires_grad_()
        out = call(this)
        weights = torch.randn(out.shape, generator=torch.Generator().manual_seed(1)).to(out)
        found = torch.autograd.grad((out * weights).sum(), list(held.values()), allow_unused=True)
        named = {
            name: torch.zeros_like(leaf) if value is None else value
            for (name, leaf), value in zip(held.items(), found, strict=True)
        }
        outcomes.append({"out": out.detach()} | {f"by {n}": v for n, v in named.items()})
    want, got = outcomes
    return {
        name: float((got[name].double() - value).abs().max()) / max(1, float(value.abs().max()))
        if value.numel()
        else 0.0
        for name, value in want.items()
    }


def check(found: dict[str, float]) -> None:
    """Every error is within the bound."""
    for name, error in found.items():
        assert error <= BOUND, f"{name}: {error}"


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    n=st.integers(0, 100), c=st.sampled_from([1, 3, 6, 16, 17, 32]), seed=st.integers(0, 2**20),
    share=st.sampled_from([0.0, 0.3, 1.0]), parts=st.sampled_from(sorted(PARTS)),
)  # fmt: skip
def test_it_is_the_twins_step(simd_level, n, c, seed, share, parts):
    check(errors(drawn(n, c, seed, share=share), parts))


@pytest.mark.parametrize("parts", PARTS)
def test_many_sites_whose_gradients_are_added_in_parts(simd_level, parts):
    check(errors(drawn(3000, 32, 3, edge=16), parts))


def test_bits_do_not_depend_on_threads():
    case = drawn(3000, 20, 4, edge=16)
    held = [leaf.requires_grad_() for leaf in leaves(case).values()]
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            out = run(case, "full")
            found.append([out, *torch.autograd.grad(out.cos().sum(), held)])
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_a_quaternion_of_zero_is_the_identity_without_gradient():
    case = drawn(60, 6, 5, share=1.0)
    still = case[1]["quaternions"]
    still[::2] = 0
    unit = still.clone()
    unit[::2, 0] = 1
    other = (case[0], case[1] | {"quaternions": unit}, *case[2:])
    still.requires_grad_()
    out = run(case, "full")
    assert torch.equal(out, run(other, "full"))
    out.cos().sum().backward()
    assert still.grad is not None
    assert not still.grad[::2].any()
    assert still.grad[1::2].any()


@pytest.mark.parametrize("name", ["features", "scales", "gate.weight0"])
def test_what_is_frozen_gets_no_gradient_and_changes_none(name):
    case = drawn(80, 6, 6)
    leaf = leaves(case)[name].requires_grad_()
    (alone,) = torch.autograd.grad(run(case, "full").cos().sum(), [leaf])
    for other in leaves(case).values():
        other.requires_grad_()
    (among,) = torch.autograd.grad(run(case, "full").cos().sum(), [leaf])
    assert torch.equal(alone, among)


def test_a_wrong_gradient_is_seen():
    """The comparison itself: an error of any number fails it."""
    found = errors(drawn(60, 6, 7), "full")
    check(found)
    for name in found:
        with pytest.raises(AssertionError, match=name):
            check({**found, name: 1e-3})


def with_pairs(case: Case, **parts) -> Case:
    return case[0], case[1], replace(case[2], **parts), case[3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: (c[0], c[1] | {"scales": c[1]["scales"].double()}, *c[2:]), "float32"),
        (lambda c: (drawn(1, 5, 0)[0], *c[1:]), "convolution"),
        (lambda c: with_pairs(c, ends=c[2].ends[:-1]), "ends"),
        (lambda c: with_pairs(c, neighbours=c[2].neighbours + 99), "pair 0 is of"),
        (lambda c: (*c[:3], c[3].repeat(2)), r"seen\[\d+\] is \d+, expected different rows"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        run(change(drawn(60, 6, 8)), "full")


def test_what_the_kernels_cannot_do_is_left_to_the_twin():
    network, sites, _, _ = drawn(5, 6, 9)
    assert native.applies(network, *sites.values())
    deep = mlp.create((6, 6, 6), torch.Generator().manual_seed(0))
    assert not native.applies(replace(network, residual=deep), *sites.values())
    assert not native.applies(exact(drawn(5, 6, 9))[0], *sites.values())
    sites["centres"].requires_grad_()
    assert not native.applies(network, *sites.values())
