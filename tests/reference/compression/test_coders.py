"""Coders of codes: every code comes back, native bytes are the reference's, damage is refused."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.methods.kernels import codec as native
from splatproof.reference.compression import columns, gaps, harmonics, logistic
from splatproof.reference.compression.mixing import Mixing
from splatproof.reference.compression.range_coder import RangeDecoder, RangeEncoder

SEEDS = st.integers(0, 2**16)
COUNTS = st.sampled_from([0, 1, 2, 5, 30])


@settings(max_examples=50)
@given(bits=st.lists(st.tuples(st.integers(1, 65535), st.booleans()), max_size=300))
def test_bits_come_back_and_cost_what_they_are_worth(bits):
    coder = RangeEncoder()
    for p, y in bits:
        coder.bit(p, int(y))
    data = coder.finish()
    back = RangeDecoder(data)
    assert [back.bit(p) for p, _ in bits] == [int(y) for _, y in bits]
    back.finish()
    worth = sum(-math.log2((p if y else 65536 - p) / 65536) for p, y in bits)
    assert 8 * len(data) <= worth * 1.02 + 48  # four bytes at the end; a straddled interval


def test_the_tables_are_the_logistic_function():
    x = (np.arange(4096) - 2048) / 256
    assert np.abs(logistic.squash() - 65536 / (1 + np.exp(-x))).max() <= 1
    p = (np.arange(4096) + 0.5) / 4096
    inner = np.abs(np.log(p / (1 - p))) < 7.9
    assert np.abs(logistic.stretch() / 256 - np.log(p / (1 - p)))[inner].max() <= 2 / 256
    assert logistic.squash().min() > 0  # a bit that was never seen can still be written


def test_a_model_learns_what_is_always_so():
    coder, model = RangeEncoder(), Mixing(2, 16)
    for _ in range(4000):
        model.code(coder, (0, 8), 1, 0)
    assert len(coder.finish()) < 30


def codes_of(count: int, seed: int, spread: float) -> np.ndarray:
    """Sorted numbers below 2^63 with small and large gaps, and the same number twice."""
    draw = np.random.default_rng(seed)
    steps = np.exp(draw.uniform(-1, spread, count)).astype(np.int64)
    return np.minimum(steps.cumsum(), 2**63 - 1)


@settings(max_examples=40)
@given(count=COUNTS, seed=SEEDS, spread=st.sampled_from([0.0, 5.0, 38.0]))
def test_gaps_come_back_and_are_the_reference_s(count, seed, spread):
    codes = codes_of(count, seed, spread)
    data = gaps.encode_gaps(codes)
    assert native.encode_gaps(codes) == data
    for coder in (gaps, native):
        assert np.array_equal(coder.decode_gaps(data, count), codes)


@pytest.mark.parametrize("coder", [gaps, native])
def test_codes_at_the_ends_of_the_grid(coder):
    codes = np.array([0, 0, 2**63 - 1, 2**63 - 1], dtype=np.int64)
    assert np.array_equal(coder.decode_gaps(coder.encode_gaps(codes), 4), codes)
    alone = codes[-1:]
    assert np.array_equal(coder.decode_gaps(coder.encode_gaps(alone), 1), alone)


@pytest.mark.parametrize("coder", [gaps, native])
def test_codes_that_decrease_are_refused(coder):
    with pytest.raises((DataError, ValueError), match="decrease"):
        coder.encode_gaps(np.array([3, 2], dtype=np.int64))


@settings(max_examples=30)
@given(count=COUNTS, seed=SEEDS, flat=st.integers(0, 3), window=st.sampled_from([1, 4, 128]))
def test_cells_their_places_and_their_neighbours(count, seed, flat, window):
    cells = np.random.default_rng(seed).integers(0, 2**21, (count, 3)).astype(np.int32)
    cells[:, :flat] = 7
    codes = gaps.morton_of_cells(cells)
    assert np.array_equal(native.morton_of_cells(cells), codes)
    for coder in (gaps, native):
        assert np.array_equal(coder.cells_of_morton(codes), cells)
    near = gaps.nearest_before(cells, window)
    assert np.array_equal(native.nearest_before(cells, window), near)
    for i, found in enumerate(near.tolist()):
        held = [j for j in found if j >= 0]
        assert len(held) == min(3, i, window)
        assert all(max(0, i - window) <= j < i for j in held)


def near_of(count: int, seed: int) -> np.ndarray:
    cells = np.random.default_rng(seed).integers(0, 9, (count, 3)).astype(np.int32)
    return gaps.nearest_before(cells)


@settings(max_examples=40)
@given(count=COUNTS, seed=SEEDS, bits=st.lists(st.integers(0, 12), max_size=3))
def test_columns_come_back_and_are_the_reference_s(count, seed, bits):
    draw = np.random.default_rng(seed)
    near, depth = near_of(count, seed), np.array(bits, dtype=np.int32)
    side = draw.integers(0, 50, count).astype(np.int32)
    codes = (draw.random((len(bits), count)) ** 3 * (1 << depth[:, None])).astype(np.int32)
    data = columns.encode_columns(codes, depth, near, side)
    assert native.encode_columns(codes, depth, near, side) == data
    for coder in (columns, native):
        assert np.array_equal(coder.decode_columns(data, depth, near, side), codes)


@settings(max_examples=20)
@given(
    count=COUNTS, seed=SEEDS, bands=st.sampled_from([0, 1, 3]),
    size=st.sampled_from([0.0, 0.5, 6.0, 3e5]),
)  # fmt: skip
@example(count=30, seed=0, bands=3, size=3e5)
def test_harmonics_come_back_and_are_the_reference_s(count, seed, bands, size):
    draw = np.random.default_rng(seed)
    near, classes = near_of(count, seed), draw.integers(0, 7, count).astype(np.int32)
    codes = (
        np.rint(draw.laplace(0, size, (3 * bands, count))) if size else np.zeros((3 * bands, count))
    )
    codes = codes.clip(-(2**20), 2**20).astype(np.int32)
    data = harmonics.encode_harmonics(codes, near, classes)
    assert native.encode_harmonics(codes, near, classes) == data
    for coder in (harmonics, native):
        assert np.array_equal(coder.decode_harmonics(data, 3 * bands, near, classes), codes)


def told(work) -> str:
    """What a decoder answers to a stream: its codes, or that it refuses them."""
    try:
        return str(work().tolist())
    except DataError:
        return "refused"


@settings(max_examples=20)
@given(seed=SEEDS, data=st.binary(max_size=60), cut=st.integers(0, 40))
def test_streams_that_nobody_wrote_are_answered_alike(seed, data, cut):
    near, zeros, bits = near_of(8, seed), np.zeros(8, dtype=np.int32), np.array([5, 8], np.int32)
    written = harmonics.encode_harmonics(near.T.copy(), near, zeros)
    for stream in (data, written[:cut], written + data):
        assert told(lambda s=stream: gaps.decode_gaps(s, 8)) == told(
            lambda s=stream: native.decode_gaps(s, 8)
        )
        assert told(lambda s=stream: columns.decode_columns(s, bits, near, zeros)) == told(
            lambda s=stream: native.decode_columns(s, bits, near, zeros)
        )
        found = told(lambda s=stream: harmonics.decode_harmonics(s, 3, near, zeros))
        assert found == told(lambda s=stream: native.decode_harmonics(s, 3, near, zeros))
        if stream is not data and stream != written:
            assert found == "refused"


def test_native_arguments_that_do_not_fit_are_refused():
    near, zeros = near_of(4, 0), np.zeros(4, dtype=np.int32)
    codes = np.zeros((3, 4), dtype=np.int32)
    with pytest.raises(ValueError, match="nearest"):
        native.encode_harmonics(codes, near + 1, zeros)
    with pytest.raises(ValueError, match="classes"):
        native.encode_harmonics(codes, near, zeros + 7)
    with pytest.raises(ValueError, match="codes"):
        native.encode_columns(codes + 4, np.full(3, 2, dtype=np.int32), near, zeros)
    with pytest.raises(ValueError, match="bits"):
        native.encode_columns(codes, np.full(3, 13, dtype=np.int32), near, zeros)
    with pytest.raises(ValueError, match="cells"):
        native.morton_of_cells(near - 1)
