"""Random fields: range, mean, smoothness, the same everywhere."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.datasets.procedural.noise import cell_random, fbm, value_noise


def places(count, dims, seed=0, scale=100.0):
    return torch.from_numpy(
        np.random.default_rng(seed).uniform(-scale, scale, (count, dims))
    ).float()


@pytest.mark.parametrize("dims", [2, 3])
def test_noise_meets_the_lattice_numbers_at_whole_positions(dims):
    cells = places(500, dims).round()
    # grid_sample sees positions relative to a table of 256 cells in float32: 2^-15 of a cell
    assert torch.allclose(value_noise(cells, 3), cell_random(cells, 3), atol=1e-4)


@given(seed=st.integers(0, 1000), dims=st.sampled_from([2, 3]))
def test_noise_is_smooth_and_within_zero_and_one(seed, dims):
    start = places(200, dims, seed)
    values = value_noise(start, seed)
    assert 0 <= float(values.min()) <= float(values.max()) <= 1
    near = value_noise(start + 1e-3, seed)
    # smoothstep has slope 1.5 at most on each axis
    assert float((near - values).abs().max()) < 1.5e-3 * dims + 2e-4


@pytest.mark.parametrize("dims", [2, 3])
def test_fbm_has_mean_one_half_and_fades_with_the_footprint(dims):
    start = places(20_000, dims)
    sharp = fbm(start, 3.0, 5, 1)
    assert abs(float(sharp.mean()) - 0.5) < 0.02
    faded = fbm(start, 3.0, 5, 1, torch.full((len(start),), 10.0))
    assert torch.equal(faded, torch.full_like(faded, 0.5))
    fine = fbm(start, 3.0, 5, 1, torch.full((len(start),), 1e-3))
    assert torch.allclose(fine, sharp, atol=1e-6)


def test_seeds_give_other_fields():
    start = places(5000, 2)
    a, b = value_noise(start, 1), value_noise(start, 2)
    assert abs(float(torch.corrcoef(torch.stack([a, b]))[0, 1])) < 0.1


def test_golden_values():
    """The numbers that every machine must find."""
    start = torch.tensor([[0.25, 0.5], [10.1, -3.7], [1234.5, 77.0]])
    want = torch.tensor(GOLDEN)
    assert torch.allclose(fbm(start, 2.0, 4, 5), want, atol=1e-5)


GOLDEN = [0.4901944, 0.4627849, 0.5929405]
