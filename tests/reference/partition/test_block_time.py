"""The model of block times: its arithmetic, its fit, and weights that even times out."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.reference.partition.block_time import (
    BlockWork,
    StepCost,
    block_seconds,
    fit_step_cost,
    reweighted,
)

COSTS = st.builds(
    StepCost, pixel=st.floats(1e-9, 1e-6), gaussian=st.floats(1e-9, 1e-6), seen=st.floats(1e-9, 1e-6)
)
WORKS = st.builds(
    BlockWork, steps=st.floats(1, 1e5), pixels=st.floats(1e3, 1e7), gaussians=st.floats(1, 1e7),
    seen=st.floats(1, 1e6),
)  # fmt: skip


def work(steps: float, pixels: float, gaussians: float, seen: float) -> BlockWork:
    values = map(float, (steps, pixels, gaussians, seen))
    return BlockWork(**dict(zip(("steps", "pixels", "gaussians", "seen"), values, strict=True)))


def test_seconds_by_hand():
    cost = StepCost(pixel=1e-7, gaussian=3e-8, seen=2e-7)
    assert block_seconds(work(100, 1e5, 3e5, 1e5), cost) == pytest.approx(100 * (0.01 + 0.009 + 0.02))
    # visits of each view: the load that ODBP balances is one of three parts
    views, visits, load = 25, 40, 2_000_000
    whole = block_seconds(work(visits * views, 0, 0, load / views), cost)
    assert whole == pytest.approx(visits * cost.seen * load)


@settings(max_examples=60)
@given(cost=COSTS, one=WORKS, share=st.floats(0.1, 1.0))
def test_less_work_takes_no_longer(cost, one, share):
    whole = block_seconds(one, cost)
    for name in ("steps", "pixels", "gaussians", "seen"):
        less = BlockWork(**{**vars(one), name: share * getattr(one, name)})
        assert block_seconds(less, cost) <= whole * (1 + 1e-12)
    assert block_seconds(BlockWork(**{**vars(one), "steps": share * one.steps}), cost) == (
        pytest.approx(share * whole)
    )


@settings(max_examples=40, deadline=None)
@given(cost=COSTS, seed=st.integers(0, 1000))
def test_the_fit_finds_the_coefficients_of_times_that_follow_the_model(cost, seed):
    rng = np.random.default_rng(seed)
    works = [work(*rng.uniform([50, 5e4, 1e5, 2e4], [500, 5e5, 1e6, 2e5])) for _ in range(12)]
    found = fit_step_cost(works, [block_seconds(one, cost) for one in works])
    for name, value in vars(cost).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-5)


def test_no_coefficient_is_below_zero_and_noise_moves_the_fit_little():
    cost = StepCost(pixel=8e-8, gaussian=3e-8, seen=2e-7)
    rng = np.random.default_rng(1)
    works = [work(*rng.uniform([50, 1e5, 1e5, 2e4], [500, 1.2e5, 1e6, 2e5])) for _ in range(16)]
    noisy = [block_seconds(one, cost) * rng.uniform(0.95, 1.05) for one in works]
    found = fit_step_cost(works, noisy)
    assert min(vars(found).values()) >= 0
    for one, seconds in zip(works, noisy, strict=True):
        assert block_seconds(one, found) == pytest.approx(seconds, rel=0.1)
    # times that fall with the Gaussians are no reason for a negative coefficient
    falling = fit_step_cost(
        [work(1, 1e5, g, 1e4) for g in (1e5, 2e5, 3e5)], [0.03, 0.02, 0.01]
    )
    assert falling.gaussian == 0


def test_what_no_block_has_gets_no_coefficient():
    found = fit_step_cost([work(10, 0, 1e5, 0), work(10, 0, 2e5, 0)], [1.0, 2.0])
    assert (found.pixel, found.seen) == (0, 0)
    assert found.gaussian == pytest.approx(1e-6)


@pytest.mark.parametrize("seconds", [[], [1.0], [0.0, 1.0], [math.nan, 1.0], [math.inf, 1.0]])
def test_times_without_sense_are_refused(seconds):
    with pytest.raises(DataError, match="times"):
        fit_step_cost([work(1, 1, 1, 1), work(1, 2, 1, 1)], seconds)


@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_coefficients_without_sense_are_refused(value):
    with pytest.raises(DataError, match="expected finite"):
        StepCost(pixel=1e-7, gaussian=value, seen=0.0)
    with pytest.raises(DataError, match="expected finite"):
        StepCost(pixel=0.0, gaussian=0.0, seen=0.0)


@settings(max_examples=60)
@given(seed=st.integers(0, 1000), blocks=st.integers(1, 5))
def test_a_blocks_new_weight_is_its_share_of_the_seconds(seed, blocks):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.cat([torch.arange(blocks), torch.randint(blocks, (40,), generator=generator)])
    weights = 0.1 + 9 * torch.rand(len(labels), generator=generator, dtype=torch.float64)
    seconds = 0.1 + torch.rand(blocks, generator=generator, dtype=torch.float64)
    found = reweighted(weights, labels, seconds)
    held = torch.zeros(blocks, dtype=torch.float64).index_add_(0, labels, found)
    assert torch.allclose(held, weights.sum() * seconds / seconds.sum())
    for block in range(blocks):  # within a block nothing is moved
        own = labels == block
        assert torch.allclose(found[own] / weights[own], (found[own] / weights[own])[0])


def test_equal_times_change_no_weight_and_empty_blocks_harm_nothing():
    weights = torch.tensor([1.0, 3.0, 4.0]).double()
    labels = torch.tensor([0, 0, 2])
    even = reweighted(weights, labels, torch.tensor([1.0, 0.0, 1.0]).double())
    assert torch.allclose(even, weights)
    nothing = reweighted(0 * weights, labels, torch.tensor([1.0, 1.0, 1.0]).double())
    assert torch.equal(nothing, 0 * weights)
    still = reweighted(weights, labels, torch.zeros(3).double())
    assert bool(still.isfinite().all())
