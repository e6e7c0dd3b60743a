"""Adaptive density control: exact counts, disjoint rules, moments, never empty."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import camera, random_gaussians
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.training.density import Density, densify, reset_opacity
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.optimizer import Adam
from splatproof.reference.rasterizer.rotation import covariance
from splatproof.reference.types.gaussians import Gaussians


def drawn(count: int, seed: int) -> tuple[Gaussians, torch.Tensor]:
    """Gaussians and gradients, about half of them above 2e-4."""
    generator = torch.Generator().manual_seed(seed)
    return random_gaussians(count, seed=seed), 4e-4 * torch.rand(count, generator=generator)


def apply(model, gradient, settings=Density(), **given):  # noqa: B008 (frozen)
    options: dict[str, Any] = {
        "extent": 10.0,
        "prune_large": False,
        "generator": torch.Generator().manual_seed(0),
    }
    return densify(model, gradient, settings, **(options | given))


@given(count=st.integers(1, 60), seed=st.integers(0, 999))
def test_counts_are_exact_and_rules_disjoint(count, seed):
    model, gradient = drawn(count, seed)
    rows = apply(model, gradient, Density(least_opacity=0.0))
    large = model.scales.amax(dim=1) > 0.1
    clones = (gradient >= 2e-4) & ~large
    splits = (gradient >= 2e-4) & large
    assert len(rows.parents) == count + clones.sum() + splits.sum()
    times = rows.parents.bincount(minlength=count)
    assert (times == 1 + (clones | splits).long()).all()
    old = rows.parents[~rows.fresh]
    assert (old.bincount(minlength=count) == (~splits).long()).all()


@given(count=st.integers(1, 60), seed=st.integers(0, 999))
def test_a_clone_is_a_copy_and_a_child_is_smaller(count, seed):
    model, gradient = drawn(count, seed)
    rows = apply(model, gradient, Density(least_opacity=0.0))
    child = rows.fresh & (model.scales[rows.parents].amax(dim=1) > 0.1)
    same = ~child
    assert torch.equal(rows.means[same], model.means[rows.parents[same]])
    assert torch.equal(rows.log_scales[same], model.log_scales[rows.parents[same]])
    shrunk = model.scales[rows.parents[child]] / 1.6
    torch.testing.assert_close(rows.log_scales[child].exp(), shrunk)


def test_children_are_drawn_from_their_parent():
    one = random_gaussians(1)
    model = Gaussians(
        means=one.means.repeat(20_000, 1), quaternions=one.quaternions.repeat(20_000, 1),
        log_scales=torch.tensor([[0.5, 1.0, 2.0]]).log().repeat(20_000, 1),
        opacity_logits=one.opacity_logits.repeat(20_000), sh=one.sh.repeat(20_000, 1, 1),
    )  # fmt: skip
    rows = apply(model, torch.ones(20_000))
    want = (one.quaternions.double(), torch.tensor([[0.5, 1.0, 2.0]]).double())
    # 40,000 draws: the mean is off by 2 / 200 = 0.01, a covariance of 4 by 4 sqrt(2) / 200 = 0.03
    assert (rows.means.mean(dim=0) - one.means[0]).abs().max() < 0.05
    assert (rows.means.T.cov() - covariance(*want)[0]).abs().max() < 0.15


def test_transparent_and_large_ones_go_but_never_all():
    model, _ = drawn(8, 0)
    still = torch.zeros(8)
    assert len(apply(model, still, Density(least_opacity=0.999)).parents) == 1
    kept = apply(model, still, Density(least_opacity=0.999)).parents
    assert kept.item() == model.opacities.argmax()
    small = apply(model, still, extent=1.5, prune_large=True).parents
    assert (model.scales[small].amax(dim=1) <= 0.15).all()
    assert 1 <= len(small) < 8
    assert len(apply(model, still, extent=1.5).parents) == 8


@given(cap=st.integers(1, 80), seed=st.integers(0, 99))
def test_cap_holds_and_takes_the_largest_gradients(cap, seed):
    model, gradient = drawn(40, seed)
    rows = apply(model, gradient, Density(least_opacity=0.0, most=cap))
    assert len(rows.parents) <= max(40, cap)
    grown = rows.parents.bincount(minlength=40) > 1
    if grown.any():
        assert gradient[grown].min() >= gradient[~grown].where(gradient[~grown] >= 2e-4, 0).max()


def test_same_generator_same_children():
    model, gradient = drawn(40, 3)
    assert torch.equal(apply(model, gradient).means, apply(model, gradient).means)
    other = apply(model, gradient, generator=torch.Generator().manual_seed(1))
    assert not torch.equal(apply(model, gradient).means, other.means)


def test_moments_follow_survivors_and_start_at_zero_for_the_new():
    parameters = Parameters({"means": torch.arange(12.0).reshape(4, 3)})
    parameters.rows["means"].grad = torch.arange(12.0).reshape(4, 3)
    adam = Adam(parameters)
    adam.step({"means": 0.1})
    first, second = adam.first["means"].clone(), adam.second["means"].clone()
    adam.edit(Edit(parents=torch.tensor([2, 0, 0]), fresh=torch.tensor([False, False, True])))
    assert torch.equal(adam.first["means"][:2], first[[2, 0]])
    assert torch.equal(adam.second["means"][:2], second[[2, 0]])
    assert not adam.first["means"][2].any()
    assert not adam.second["means"][2].any()


def test_reset_lowers_only():
    logits = torch.tensor([-7.0, 3.0])
    assert reset_opacity(logits)[0] == -7
    assert reset_opacity(logits)[1].sigmoid() == pytest.approx(0.01)


def test_statistics_are_means_over_the_views_that_saw():
    control = DensityControl(Density(), iterations=30_000, extent=1.0)
    gradient = torch.tensor([[3.0, 8.0], [1.0, 1.0]])
    seen = Observation(
        camera=camera(0, width=20, height=10), radii=torch.tensor([1.0, 0.0]), opacities=None,
        signed=gradient, absolute=None, rows=None, slots=None, count=2,
    )  # fmt: skip
    control.observe(seen)
    control.observe(replace(seen, signed=0 * gradient))
    assert control.gradient_sum.tolist() == [math.hypot(30, 40), 0.0]
    assert control.seen.tolist() == [2, 0]


def test_schedule_of_a_full_run_is_the_release():
    control = DensityControl(Density(), iterations=30_000, extent=1.0)
    dense = [step for step in range(1, 30_001) if control.densifies(step)]
    assert dense == list(range(600, 15_000, 100))
    assert [step for step in range(1, 30_001) if control.resets(step)] == [3000, 6000, 9000, 12_000]


@pytest.mark.parametrize("iterations", [200, 1000, 2000, 7000])
def test_a_short_run_is_a_whole_one(iterations):
    control = DensityControl(Density(), iterations=iterations, extent=1.0)
    steps = range(1, iterations + 1)
    assert [s for s in steps if control.watches(s)][-1] < 0.51 * iterations
    dense = [s for s in steps if control.densifies(s)]
    assert all(b - a >= 100 for a, b in pairwise(dense))
    if iterations >= 1000:
        assert dense


@given(
    iterations=st.integers(1, 29_999), start=st.integers(0, 12_000), least=st.integers(1, 300),
    fewest=st.integers(0, 9),
)  # fmt: skip
def test_a_run_of_any_length_densifies_as_often_as_is_asked(iterations, start, least, fewest):
    settings = Density(start=start, least_interval=least)
    usual, control = (
        DensityControl(one, iterations=iterations, extent=1.0)
        for one in (settings, replace(settings, fewest=fewest))
    )
    steps = range(1, iterations + 1)
    before, dense = ([s for s in steps if c.densifies(s)] for c in (usual, control))
    between = control.settings.stop - control.settings.start - 1
    assert len(dense) >= min(fewest, between)
    if len(before) >= fewest:
        assert dense == before


def test_who_asks_for_no_densification_gets_none():
    control = DensityControl(Density(stop=0, fewest=3), iterations=400, extent=1.0)
    assert not any(control.densifies(step) for step in range(1, 401))


def test_large_gaussians_are_split_by_the_absolute_gradient_and_small_ones_cloned_by_the_signed():
    model, _ = drawn(4, 3)
    size = torch.tensor([0.001, 0.001, 0.5, 0.5])
    model = replace(model, log_scales=size.log()[:, None].repeat(1, 3),
                    opacity_logits=torch.zeros(4))  # fmt: skip
    signed, absolute = torch.tensor([1.0, 0, 1, 0]), torch.tensor([0.0, 1, 0, 1])
    settings = Density(gradient=0.5, split_gradient=0.5, largest_size=10.0)
    rows = densify(
        model, signed, settings, extent=1.0, prune_large=False,
        generator=torch.Generator().manual_seed(0), absolute=absolute,
    )  # fmt: skip
    assert rows.parents.tolist() == [0, 1, 2, 0, 3, 3]  # 0 is cloned, 3 is split


@pytest.mark.parametrize(("room", "grown"), [(1, {1}), (2, {1, 3}), (3, {0, 1, 3})])
def test_under_a_cap_those_go_first_whose_pull_is_the_largest_multiple_of_its_own_threshold(
    room, grown
):
    model, _ = drawn(5, 3)
    size = torch.tensor([0.001, 0.001, 0.001, 0.5, 0.5])
    model = replace(model, log_scales=size.log()[:, None].repeat(1, 3),
                    opacity_logits=torch.zeros(5))  # fmt: skip
    signed = torch.tensor([1.5, 2.5, 0.5, 0.2, 9.0])  # cloned from 1 on
    absolute = torch.tensor([9.0, 9.0, 9.0, 8.0, 3.5])  # split from 4 on
    settings = Density(gradient=1.0, split_gradient=4.0, most=5 + room, largest_size=10.0)
    rows = densify(
        model, signed, settings, extent=1.0, prune_large=False,
        generator=torch.Generator().manual_seed(0), absolute=absolute,
    )  # fmt: skip
    assert set(rows.parents[rows.fresh].tolist()) == grown


@pytest.mark.parametrize("seed", range(3))
def test_sums_of_absolute_gradients_are_those_of_their_definition(seed):
    draw = torch.Generator().manual_seed(seed)
    control = DensityControl(Density(split_gradient=4e-4), iterations=30_000, extent=1.0)
    want = torch.zeros(50)
    for _ in range(3):
        seen = Observation(
            camera=camera(0, width=20, height=10), opacities=None, rows=None, slots=None, count=50,
            radii=torch.rand(50, generator=draw).sub(0.5).clamp(min=0),
            signed=torch.randn(50, 2, generator=draw), absolute=torch.rand(50, 2, generator=draw),
        )  # fmt: skip
        control.observe(seen)
        want += torch.where(seen.radii > 0, seen.gradient_norm("absolute"), 0)
    assert torch.allclose(control.absolute_sum, want, rtol=1e-6)
    assert 0 < control.seen.max() <= 3


def test_absolute_statistics_are_taken_and_restored_beside_the_signed():
    control = DensityControl(Density(split_gradient=4e-4), iterations=30_000, extent=1.0)
    assert control.needs == {"signed", "absolute"}
    assert DensityControl(Density(), iterations=9, extent=1.0).needs == {"signed"}
    seen = Observation(
        camera=camera(0, width=20, height=10), radii=torch.tensor([1.0, 0.0]), opacities=None,
        signed=torch.zeros(2, 2), absolute=torch.tensor([[3.0, 8.0], [1.0, 1.0]]), rows=None,
        slots=None, count=2,
    )  # fmt: skip
    control.observe(seen)
    again = DensityControl(Density(split_gradient=4e-4), iterations=30_000, extent=1.0)
    again.restore(control.state())
    for each in (control, again):
        assert each.absolute_sum.tolist() == [math.hypot(30, 40), 0.0]
        assert each.gradient_sum.tolist() == [0.0, 0.0]
        assert each.seen.tolist() == [1, 0]
