"""Quantisers: bounds of each step, codes that stay, and numbers that are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.methods.kernels import codec as native
from splatproof.reference.compression import quantisers

SEEDS = st.integers(0, 2**16)
COUNTS = st.integers(0, 20)
FLOAT32 = 2.0**-23
"""Of a number that was kept in float32."""


def kept(values: np.ndarray) -> np.ndarray:
    """As they come back from a file."""
    return values.astype(np.float32).astype(np.float64)


@given(count=COUNTS, seed=SEEDS, step=st.sampled_from([1e-3, 0.1, 0.7]))
def test_uniform_codes_are_within_half_a_step_and_stay(count, seed, step):
    values = np.random.default_rng(seed).normal(0, 3, (count, 3))
    codes = quantisers.uniform("x", values, step)
    assert (np.abs(codes * step - values) <= step / 2 * (1 + 1e-9)).all()
    assert np.array_equal(quantisers.uniform("x", kept(codes * step), step), codes)


@given(count=COUNTS, seed=SEEDS, step=st.sampled_from([1e-4, 0.013, 2.0]))
def test_cells_are_within_half_a_step_and_stay(count, seed, step):
    far = step * quantisers.MOST_CELL
    means = np.random.default_rng(seed).uniform(-far, far, (count, 3))
    cells = quantisers.cells(means, step)
    assert (np.abs(cells * step - means) <= step / 2 * (1 + 1e-6)).all()
    assert np.array_equal(quantisers.cells(kept(cells * step), step), cells)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e9])
def test_numbers_beyond_the_grid_are_refused(value):
    bad = np.array([[0.0, 0, value]])
    with pytest.raises(DataError, match="positions"):
        quantisers.cells(bad, 0.01)
    with pytest.raises(DataError, match="log scale"):
        quantisers.uniform("log scale", bad, 0.1)
    with pytest.raises(DataError, match="SH"):
        quantisers.harmonic_codes(bad[None], np.array([3], np.int32), 0.01)
    if not np.isfinite(value):
        with pytest.raises(DataError, match="rotation"):
            quantisers.rotation_codes(np.array([[1, 0, 0, value]]), 7)


def matrices(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q.T
    rows = [[w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]]  # fmt: skip
    return np.moveaxis(np.array(rows), 2, 0)


@settings(max_examples=60)
@given(count=COUNTS, seed=SEEDS, bits=st.integers(4, 12), ties=st.booleans())
def test_rotations_keep_the_ellipsoid_and_their_codes(count, seed, bits, ties):
    draw = np.random.default_rng(seed)
    q = draw.integers(-1, 2, (count, 4)).astype(float) if ties else draw.normal(size=(count, 4))
    codes = quantisers.rotation_codes(q, bits)
    back = quantisers.rotations(codes, bits)
    assert np.array_equal(quantisers.rotation_codes(kept(back), bits), codes)
    q[(q == 0).all(axis=1), 0] = 1  # no rotation
    q /= np.linalg.norm(q, axis=1, keepdims=True) if count else 1
    # each axis of the ellipsoid is the same line: turned by no more than what rounding turns
    away = np.abs(matrices(q).swapaxes(1, 2) @ matrices(back)) - np.eye(3)
    # x, y and z are off by h = step / 2 and w, at least 1/2, by (|x| + |y| + |z|) h / w <= 3 h to first
    # order: sqrt(12) h in all, an angle of twice that; the second order is a fifth of it at 4 bits
    step = 1 / (((1 << (bits - 1)) - 1) * np.sqrt(2))
    assert (np.abs(away) <= 2 * np.sqrt(12) * step / 2 * (1 + 3 * step)).all()


@given(count=COUNTS, seed=SEEDS)
def test_colour_differences_lose_nothing(count, seed):
    rgb = np.random.default_rng(seed).integers(-(2**15), 2**15, (count, 3)).astype(np.int32)
    codes = quantisers.colour_difference(rgb)
    assert np.array_equal(quantisers.colour(codes), rgb)
    grey = np.repeat(rgb[:, :1], 3, axis=1)
    assert not quantisers.colour_difference(grey)[:, 1:].any()


@given(seed=SEEDS, weights=st.lists(st.integers(-(2**20), 2**20), min_size=6, max_size=6))
def test_classes_follow_their_equation(seed, weights):
    draw = np.random.default_rng(seed)
    scales, a = draw.integers(-80, 30, (9, 3)), draw.integers(-90, 90, 9)
    found = quantisers.classes(scales.astype(np.int32), a.astype(np.int32), tuple(weights))
    s = np.sort(scales, axis=1)
    facts = [np.ones(9, int), a, a * a, *s.T]
    exact = sum(k * f for k, f in zip(weights, facts, strict=True)) / 2**16
    assert np.array_equal(found, 3 + np.floor(exact + 0.5).clip(-3, 3))


@settings(max_examples=50)
@given(
    count=COUNTS, seed=SEEDS, bands=st.sampled_from([0, 3, 15]),
    base=st.sampled_from([0.01, 0.06, 0.3]),
)  # fmt: skip
def test_harmonics_are_within_half_a_step_and_stay(count, seed, bands, base):
    draw = np.random.default_rng(seed)
    rest, found = (
        draw.laplace(0, 0.1, (count, bands, 3)),
        draw.integers(0, 7, count).astype(np.int32),
    )
    codes = quantisers.harmonic_codes(rest, found, base)
    back = quantisers.harmonics(codes, found, base)
    assert np.array_equal(native.harmonics(codes, found, base), back)
    assert np.array_equal(quantisers.harmonic_codes(kept(back), found, base), codes)
    error = np.einsum("cd,nkd->nkc", quantisers.OPPONENT, back - rest)
    most = 0.5 * np.ldexp(base, found - 3)[:, None, None]
    assert (np.abs(error) <= most + FLOAT32 * 4 * np.abs(rest).sum(axis=2, keepdims=True)).all()
