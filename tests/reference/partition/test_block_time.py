"""The model of block times: its arithmetic, its fit, and weights that even times out."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.methods.contracts.backends import get_backend
from splatproof.reference.partition import block_time
from splatproof.reference.partition.block_time import (
    BlockWork,
    StepCost,
    block_seconds,
    fit_step_cost,
    pairs_a_view,
    reweighted,
    tile_pairs,
)
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.splats import Splats

COSTS = st.builds(
    StepCost,
    pixel=st.floats(1e-9, 1e-6),
    gaussian=st.floats(1e-9, 1e-6),
    pair=st.floats(1e-9, 1e-6),
)
WORKS = st.builds(
    BlockWork, steps=st.floats(1, 1e5), pixels=st.floats(1e3, 1e7), gaussians=st.floats(1, 1e7),
    pairs=st.floats(1, 1e6),
)  # fmt: skip


def work(steps: float, pixels: float, gaussians: float, seen: float) -> BlockWork:
    values = map(float, (steps, pixels, gaussians, seen))
    return BlockWork(**dict(zip(("steps", "pixels", "gaussians", "pairs"), values, strict=True)))


def test_seconds_by_hand():
    cost = StepCost(pixel=1e-7, gaussian=3e-8, pair=2e-7)
    assert block_seconds(work(100, 1e5, 3e5, 1e5), cost) == pytest.approx(
        100 * (0.01 + 0.009 + 0.02)
    )
    # visits of each view: the load that ODBP balances is one of three parts
    views, visits, load = 25, 40, 2_000_000
    whole = block_seconds(work(visits * views, 0, 0, load / views), cost)
    assert whole == pytest.approx(visits * cost.pair * load)


@settings(max_examples=60)
@given(cost=COSTS, one=WORKS, share=st.floats(0.1, 1.0))
def test_less_work_takes_no_longer(cost, one, share):
    whole = block_seconds(one, cost)
    for name in ("steps", "pixels", "gaussians", "pairs"):
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
    cost = StepCost(pixel=8e-8, gaussian=3e-8, pair=2e-7)
    rng = np.random.default_rng(1)
    works = [work(*rng.uniform([50, 1e5, 1e5, 2e4], [500, 1.2e5, 1e6, 2e5])) for _ in range(16)]
    noisy = [block_seconds(one, cost) * rng.uniform(0.95, 1.05) for one in works]
    found = fit_step_cost(works, noisy)
    assert min(vars(found).values()) >= 0
    for one, seconds in zip(works, noisy, strict=True):
        assert block_seconds(one, found) == pytest.approx(seconds, rel=0.1)
    # times that fall with the Gaussians are no reason for a negative coefficient
    falling = fit_step_cost([work(1, 1e5, g, 1e4) for g in (1e5, 2e5, 3e5)], [0.03, 0.02, 0.01])
    assert falling.gaussian == 0


def test_what_no_block_has_gets_no_coefficient():
    found = fit_step_cost([work(10, 0, 1e5, 0), work(10, 0, 2e5, 0)], [1.0, 2.0])
    assert (found.pixel, found.pair) == (0, 0)
    assert found.gaussian == pytest.approx(1e-6)


@pytest.mark.parametrize("seconds", [[], [1.0], [0.0, 1.0], [math.nan, 1.0], [math.inf, 1.0]])
def test_times_without_sense_are_refused(seconds):
    with pytest.raises(DataError, match="times"):
        fit_step_cost([work(1, 1, 1, 1), work(1, 2, 1, 1)], seconds)


@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_coefficients_without_sense_are_refused(value):
    with pytest.raises(DataError, match="expected finite"):
        StepCost(pixel=1e-7, gaussian=value, pair=0.0)
    with pytest.raises(DataError, match="expected finite"):
        StepCost(pixel=0.0, gaussian=0.0, pair=0.0)


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


def camera(width: int = 40, height: int = 24) -> Camera:
    """Looks along z from the origin; a metre at depth 10 is 3 pixels wide."""
    K = torch.tensor([[30.0, 0, width / 2], [0, 30.0, height / 2], [0, 0, 1]]).double()
    return Camera(K=K, world_to_camera=torch.eye(4).double(), width=width, height=height)


def test_tiles_by_hand():
    at = camera()  # 3 x 2 tiles, the middle pixel at (20, 12)
    means = torch.tensor(
        [[0.0, 0, 10], [0, 0, 10], [-4, 0, 10], [0, 0, -10], [100, 0, 10], [7.5, 0, 10]]
    )
    sizes = torch.tensor([0.01, 1.0, 0.01, 1.0, 1.0, 1.0])
    # in tile (1, 0); 11 to 29 by 3 to 21; in tile (0, 0); behind; far to the right; 33.5 to 51.5 by 3 to 21
    assert tile_pairs(at, means, sizes).tolist() == [1, 4, 1, 0, 0, 2]


@settings(max_examples=40)
@given(seed=st.integers(0, 1000), size=st.floats(1e-3, 10.0))
def test_tiles_are_those_that_a_square_of_pixels_meets(seed, size):
    generator = torch.Generator().manual_seed(seed)
    means = torch.randn(8, 3, generator=generator) * torch.tensor([6.0, 6.0, 6.0])
    at = camera()
    found = tile_pairs(at, means, torch.full((8,), size))
    for (x, y, z), count in zip(means.double().tolist(), found.tolist(), strict=True):
        want = 0
        if z > at.near:
            u, v, half = 20 + 30 * x / z, 12 + 30 * y / z, 3 * size * 30 / z
            for column in range(3):
                for row in range(2):
                    wide = min(16 * (column + 1), 40) > u - half and 16 * column <= u + half
                    tall = min(16 * (row + 1), 24) > v - half and 16 * row <= v + half
                    want += wide and tall
        assert count == want


def test_the_kernels_draw_about_as_many_pairs():
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(500, 3, generator=generator) * 3 + torch.tensor([0.0, 0, 12])
    at, sizes = camera(160, 96), torch.full((500,), 0.3)
    backend = get_backend("cpu")
    before = backend.pairs()
    round_ones = Splats(
        means=means, quaternions=torch.tensor([1.0, 0, 0, 0]).repeat(500, 1),
        scales=sizes[:, None].repeat(1, 3), opacities=torch.full((500,), 0.9),
        colours=torch.rand(500, 3, generator=generator),
    )  # fmt: skip
    backend.draw(at, round_ones, background=torch.zeros(3))
    drawn = backend.pairs() - before
    # ellipses for squares, but a filter of a third of a pixel and a reach of 3.3
    assert 0.7 < drawn / pairs_a_view([at], means, sizes) < 1.3


def test_a_mean_over_views_and_a_sample_that_stands_for_all(monkeypatch):
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(3000, 3, generator=generator) + torch.tensor([0.0, 0, 8])
    sizes, cameras = torch.full((3000,), 0.05), [camera(), camera(80, 48)]
    whole = pairs_a_view(cameras, means, sizes)
    assert whole == pytest.approx(
        sum(float(tile_pairs(c, means, sizes).sum()) for c in cameras) / 2
    )
    monkeypatch.setattr(block_time, "MOST", 1000)
    assert pairs_a_view(cameras, means, sizes) == pytest.approx(whole, rel=0.05)
    assert pairs_a_view([], means, sizes) == 0
    assert pairs_a_view(cameras, means[:0], sizes[:0]) == 0
