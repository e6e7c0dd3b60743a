"""Palette and codebooks: no worse than plain Lloyd's, exact where they can be."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.methods.storage.sog_clusters import LEVELS, clustered, codebook, labels_of, nearest


def off(rows: torch.Tensor, entries: torch.Tensor, labels: torch.Tensor) -> float:
    return float((rows - entries[labels]).square().sum(dim=1).mean())


def plain(rows: torch.Tensor, count: int) -> float:
    """Lloyd's among all entries, from evenly spaced rows."""
    entries = rows[torch.linspace(0, len(rows) - 1, count).long()].clone()
    for _ in range(10):
        labels = nearest(rows, entries)
        for one in range(count):
            if (labels == one).any():
                entries[one] = rows[labels == one].mean(dim=0)
    return off(rows, entries, nearest(rows, entries))


def drawn(count: int, width: int = 24) -> torch.Tensor:
    """Rows as harmonics are: most small, few large."""
    g = torch.Generator().manual_seed(1)
    size = torch.randn(count, 1, generator=g).exp()
    return size * torch.randn(count, width, generator=g) / torch.arange(1, width + 1)


def test_a_palette_finds_clusters_that_are_there():
    g = torch.Generator().manual_seed(0)
    centres = torch.randn(4, 9, generator=g)
    rows = centres.repeat_interleave(25, dim=0) + 0.01 * torch.randn(100, 9, generator=g)
    found, labels = clustered(rows, 4)
    assert (found[labels] - rows).abs().max() < 0.1
    assert len(labels.unique()) == 4


@pytest.mark.parametrize("count", [64, 500])
def test_a_palette_is_no_worse_than_one_of_which_all_entries_are_asked(count):
    rows = drawn(3000)
    entries, labels = clustered(rows, count)
    assert off(rows, entries, labels) < plain(rows, count)
    # nor do many rows have a nearer entry elsewhere
    assert off(rows, entries, labels) < 1.05 * off(rows, entries, nearest(rows, entries))


@given(
    count=st.integers(1, 60),
    size=st.integers(1, 60),
    scale=st.sampled_from([0.0, 1e-30, 1.0, 1e30]),
)
def test_every_row_has_an_entry(count, size, scale):
    rows = scale * drawn(size, 9)
    entries, labels = clustered(rows, count)
    assert entries.shape == (min(count, size), 9)
    assert entries.isfinite().all()
    assert labels.shape == (size,)
    assert 0 <= int(labels.min()) <= int(labels.max()) < len(entries)
    if count >= size or scale == 0:
        assert torch.equal(entries[labels], rows)


@given(values=st.lists(st.floats(-(2.0**100), 2.0**100, width=32), min_size=1, max_size=600))
def test_levels_of_few_numbers_are_these_and_labels_are_the_nearest(values):
    numbers = np.array(values, dtype=np.float32)
    levels = codebook(numbers)
    assert levels.shape == (LEVELS,)
    assert np.isfinite(levels).all()
    assert (np.diff(levels) >= 0).all()
    shown = levels[labels_of(numbers, levels)]
    if len(np.unique(numbers)) <= LEVELS:
        assert np.array_equal(shown, numbers)
    apart = np.abs(numbers.astype(np.float64)[:, None] - levels.astype(np.float64))
    assert np.allclose(np.abs(shown.astype(np.float64) - numbers), apart.min(axis=1))


def test_levels_are_nearer_than_even_ones_and_than_those_of_equal_shares():
    numbers = np.random.default_rng(0).standard_normal(20_000).astype(np.float32)
    levels = codebook(numbers)
    error = np.square(levels[labels_of(numbers, levels)] - numbers).mean()
    # Panter and Dite: the least error of many levels of a normal distribution, sqrt(3) pi / 2 / levels^2
    assert error < 1.03 * np.sqrt(3) * np.pi / 2 / LEVELS**2
    for other in (
        np.linspace(numbers.min(), numbers.max(), LEVELS),
        np.quantile(numbers, (np.arange(LEVELS) + 0.5) / LEVELS),
    ):
        some = other.astype(np.float32)
        assert error < np.square(some[labels_of(numbers, some)] - numbers).mean()
