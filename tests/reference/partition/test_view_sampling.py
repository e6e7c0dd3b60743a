"""Balanced sampling: bins by hand, every view drawn, every bin drawn equally often."""

import itertools
import math
from collections import Counter

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition import view_sampling as sampling
from splatproof.reference.partition.view_sampling import SamplingSettings

SEEDS = st.integers(0, 2**16)
D = torch.float64
EYE = torch.eye(3, dtype=D)
CENTRE = torch.zeros(3, dtype=D)


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_bins_by_hand():
    # Distances 1 ... 21 along +x: percentiles 5 and 95 are 2 and 20, thirds end at 8 and 14.
    line = torch.arange(1.0, 22, dtype=D)
    centres = torch.stack([line, 0 * line, 0 * line], dim=1)
    rings = sampling.view_bins(centres, CENTRE, EYE, SamplingSettings()).tolist()
    assert rings == [0] * 7 + [1] * 6 + [2] * 8
    # On a circle the eight azimuths begin at +x and turn towards +y.
    angles = torch.tensor([1.0, 46, 91, 136, 181, 226, 271, 316, 359], dtype=D) * math.pi / 180
    circle = torch.stack([angles.cos(), angles.sin(), 0 * angles], dim=1)
    settings = SamplingSettings(distances=1)
    assert sampling.view_bins(circle, CENTRE, EYE, settings).tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 7]


@settings(max_examples=20)
@given(count=st.integers(1, 40), seed=SEEDS, scale=st.sampled_from([0.25, 8.0]))
def test_bins_are_around_the_blocks_own_centre_in_any_unit(count, seed, scale):
    centres, centre = (
        torch.randint(-50, 50, (count + 1, 3), generator=generator(seed)).double().split([count, 1])
    )
    about_zero = sampling.view_bins(centres - centre, CENTRE, EYE, SamplingSettings())
    moved = sampling.view_bins(scale * centres, scale * centre[0], EYE, SamplingSettings())
    assert torch.equal(about_zero, moved)


def test_a_hair_before_a_whole_turn_is_in_the_last_azimuth():
    """Its share of a turn is 1 in float64."""
    centres = torch.tensor([[1.0, -1e-20, 0]], dtype=D)
    assert sampling.view_bins(centres, CENTRE, EYE, SamplingSettings()).tolist() == [7 * 3]


def test_height_counts_as_distance_and_turns_nothing():
    centres = torch.tensor([[3.0, 3, 0], [1, 1, 50], [0, 0, 9]], dtype=D)
    bins = sampling.view_bins(centres, CENTRE, EYE, SamplingSettings())
    assert (bins // 3).tolist() == [1, 1, 0]
    assert (bins % 3).tolist() == [0, 2, 0]  # distances 4.2, 50 and 9


def test_stray_distances_stay_in_the_outer_rings():
    # Forty views at distances 100 to 139, one at the centre and one at 10,000.
    line = torch.cat([torch.arange(100.0, 140), torch.tensor([0.0, 1e4])]).double()
    centres = torch.stack([line, 0 * line, 0 * line], dim=1)
    rings = sampling.view_bins(centres, CENTRE, EYE, SamplingSettings())
    assert rings.unique().tolist() == [0, 1, 2]
    assert rings[-2:].tolist() == [0, 2]


@settings(max_examples=40)
@given(count=st.integers(0, 40), seed=SEEDS, turn=st.integers(0, 7))
def test_turning_by_whole_bins_shifts_azimuths(count, seed, turn):
    centres = torch.randn(count, 3, generator=generator(seed), dtype=D)
    angle = 2 * math.pi * turn / 8 + 1e-9  # past the border that rounding could fall short of
    c, s = math.cos(angle), math.sin(angle)
    spin = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=D)
    settings = SamplingSettings()
    before = sampling.view_bins(centres, CENTRE, EYE, settings)
    after = sampling.view_bins(centres @ spin.T, CENTRE, EYE, settings)
    assert torch.equal(after // 3, (before // 3 + turn) % 8)
    # The frame carries its axes along: seen from a turned frame nothing has moved.
    exact = sampling.view_bins(centres @ spin.T, CENTRE, spin.T, settings)
    assert torch.equal(exact // 3, before // 3)


@settings(max_examples=60)
@given(bins=st.lists(st.integers(0, 9), min_size=1, max_size=40), seed=SEEDS)
def test_each_cycle_draws_each_bin_once_and_every_view_is_drawn(bins, seed):
    of_view = torch.tensor(bins)
    kinds = len(set(bins))
    longest = max(Counter(bins).values())
    draws = list(
        itertools.islice(
            sampling.balanced_draws(of_view, SamplingSettings(), generator(seed)), kinds * longest
        )
    )
    for start in range(0, len(draws), kinds):
        assert {bins[v] for v in draws[start : start + kinds]} == set(bins)
    assert set(draws) == set(range(len(bins)))
    drawn = Counter(draws)
    for kind in set(bins):  # inside a bin no view is dealt twice before all are dealt once
        times = [drawn[v] for v in range(len(bins)) if bins[v] == kind]
        assert max(times) - min(times) <= 1


@settings(max_examples=20)
@given(bins=st.lists(st.integers(0, 3), min_size=1, max_size=9), seed=SEEDS)
def test_a_seed_decides_the_draws(bins, seed):
    a, b = (
        sampling.balanced_draws(
            torch.tensor(bins), SamplingSettings(uniform_share=0.3), generator(seed)
        )
        for _ in range(2)
    )
    assert list(itertools.islice(a, 50)) == list(itertools.islice(b, 50))


def test_the_uniform_share_draws_all_views_alike():
    bins = torch.tensor([0] * 9 + [1])  # balanced draws take the last view every second time
    settings = SamplingSettings(uniform_share=1.0)
    draws = Counter(itertools.islice(sampling.balanced_draws(bins, settings, generator(0)), 10_000))
    # Binomial(10000, 1/10): standard deviation 30; 5 of them.
    assert all(abs(draws[v] - 1000) <= 150 for v in range(10))
    balanced = Counter(
        itertools.islice(sampling.balanced_draws(bins, SamplingSettings(), generator(0)), 1000)
    )
    assert balanced[9] == 500


def test_shuffles_differ_between_rounds():
    draws = sampling.balanced_draws(torch.zeros(20).long(), SamplingSettings(), generator(1))
    rounds = [tuple(itertools.islice(draws, 20)) for _ in range(4)]
    assert len(set(rounds)) == 4


@pytest.mark.parametrize(
    ("bins", "step"), [(1, 1), (2, 1), (3, 2), (4, 3), (5, 3), (6, 5), (24, 13)]
)
def test_strides(bins, step):
    # The nearest to 0.618 bins that shares no divisor with them; on a tie the smaller.
    assert sampling.stride(bins) == step
    assert len({i * step % bins for i in range(bins)}) == bins


def test_nothing_to_draw_from_is_refused():
    with pytest.raises(DataError, match="no views"):
        next(sampling.balanced_draws(torch.zeros(0).long(), SamplingSettings(), generator(0)))


@pytest.mark.parametrize("wrong", [{"azimuths": 0}, {"distances": 0}, {"uniform_share": 1.5}])
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(UsageError):
        sampling.view_bins(torch.zeros(2, 3).double(), CENTRE, EYE, SamplingSettings(**wrong))
