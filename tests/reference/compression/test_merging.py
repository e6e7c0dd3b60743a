"""Merging: mass, mean, covariance and colour of a pair stay; equal ones cost nothing."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.sh_models import model
from splatproof.reference.compression import merging
from splatproof.reference.rasterizer.rotation import covariance, rotation_matrix
from splatproof.reference.types.gaussians import Gaussians

SEEDS = st.integers(0, 2**16)


def near_model(count: int, seed: int) -> Gaussians:
    whole = model(count, 2, seed)
    g = torch.Generator().manual_seed(seed)
    values = {name: part.double() for name, part in vars(whole).items()}
    values["means"] = torch.rand(count, 3, generator=g, dtype=torch.float64)
    values["log_scales"] = torch.rand(count, 3, generator=g, dtype=torch.float64) - 2
    return Gaussians(**values)


def spread(model: Gaussians) -> torch.Tensor:
    return covariance(model.quaternions, model.log_scales.exp())


@settings(max_examples=30)
@given(seed=SEEDS)
def test_mass_mean_covariance_and_colour_of_the_whole_stay(seed):
    whole = near_model(7, seed)
    mass = torch.rand(7, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) + 0.01
    found, weights = merging.merged(whole, torch.tensor([[5, 1], [0, 6]]), mass)
    assert len(found) == 5
    assert torch.equal(found.means[:3], whole.means[[2, 3, 4]])
    assert torch.equal(weights[:3], mass[[2, 3, 4]])

    def moments(model: Gaussians, mass: torch.Tensor) -> list[torch.Tensor]:
        second = spread(model) + model.means[:, :, None] * model.means[:, None, :]
        parts = (torch.ones(len(model), 1), model.means, second, model.sh)
        return [torch.einsum("n,n...->...", mass, part.double()) for part in parts]

    for a, b in zip(moments(found, weights), moments(whole, mass), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_opacity_times_area_stays_unless_one_would_be_denser_than_both(seed):
    whole = near_model(2, seed)
    found, _ = merging.merged(whole, torch.tensor([[0, 1]]), torch.ones(2, dtype=torch.float64))
    a, b = whole.opacities
    covered = (whole.opacities * merging.areas(whole.log_scales)).sum()
    want = min(float(covered / merging.areas(found.log_scales)[0]), float(1 - (1 - a) * (1 - b)))
    assert float(found.opacities[0]) == pytest.approx(want, abs=1e-6)


def test_two_equal_ones_cost_nothing_and_become_one_of_their_shape():
    whole = near_model(1, 3)
    twice = Gaussians(**{name: torch.cat([part, part]) for name, part in vars(whole).items()})
    pair, mass = torch.tensor([[0, 1]]), torch.ones(2, dtype=torch.float64)
    assert float(merging.costs(twice, pair, mass)[0]) == pytest.approx(0, abs=1e-9)
    found, _ = merging.merged(twice, pair, mass)
    torch.testing.assert_close(spread(found), spread(whole), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.means, whole.means)
    torch.testing.assert_close(found.sh, whole.sh)
    a = float(whole.opacities[0])
    assert float(found.opacities[0]) == pytest.approx(1 - (1 - a) ** 2, abs=1e-6)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_a_pair_costs_more_the_farther_apart_and_the_more_unlike_it_is(seed):
    whole = near_model(2, seed)
    pair, mass = torch.tensor([[0, 1]]), torch.tensor([1.0, 2.0])
    cost = merging.costs(whole, pair, mass)
    assert cost >= 0
    away = whole.means - whole.means[:1] * 0
    away[1] += 10 * (whole.means[1] - whole.means[0])
    sh = whole.sh.clone()
    sh[1] += 10 * (sh[1] - sh[0])
    kept = vars(whole)
    assert merging.costs(Gaussians(**kept | {"means": away}), pair, mass) > cost
    assert merging.costs(Gaussians(**kept | {"sh": sh}), pair, mass) > cost
    torch.testing.assert_close(merging.costs(whole, pair, 3 * mass), 3 * cost)
    torch.testing.assert_close(merging.costs(whole, pair.flip(1), mass), cost)


def test_flat_ones_that_have_no_volume_are_not_merged():
    whole = near_model(2, 0)
    flat = Gaussians(
        **vars(whole) | {"log_scales": torch.full((2, 3), -400.0), "means": whole.means * 0}
    )
    pair = torch.tensor([[0, 1]])
    cost = merging.costs(flat, pair, torch.ones(2))
    assert len(merging.matched(pair, cost, 1)) == 0


@given(seed=SEEDS, number=st.integers(0, 12))
def test_the_cheapest_are_taken_each_gaussian_once(seed, number):
    g = torch.Generator().manual_seed(seed)
    pairs = torch.randint(0, 12, (40, 2), generator=g)
    cost = torch.rand(40, generator=g)
    found = merging.matched(pairs, cost, number)
    assert len(found) <= number
    flat = found.flatten().tolist()
    assert len(set(flat)) == len(flat)
    if number:
        apart = pairs[:, 0] != pairs[:, 1]
        assert found[0].tolist() == pairs[cost.where(apart, torch.inf).argmin()].tolist()
    if len(found) < number:  # nothing that could still be taken is left
        assert all({a, b} & set(flat) or a == b for a, b in pairs.tolist())


@given(seed=SEEDS)
def test_quaternions_of_rotations_turn_alike(seed):
    g = torch.Generator().manual_seed(seed)
    turned = rotation_matrix(torch.randn(5, 4, generator=g, dtype=torch.float64))
    half = rotation_matrix(torch.eye(4, dtype=torch.float64))  # none, and half turns
    both = torch.cat([turned, half])
    torch.testing.assert_close(rotation_matrix(merging.quaternions(both)), both, rtol=0, atol=1e-9)
