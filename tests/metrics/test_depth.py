"""Depth errors against scalar loops and numbers worked by hand."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.images import noise_image, random_mask
from splatproof.base.errors import DataError
from splatproof.metrics.depth import depth_errors


def depths(height: int, width: int, seed: int):
    return 0.5 + 3 * noise_image(height, width, seed)[..., 0].double()


def slow_errors(depth, truth, mask):
    pairs = [
        (float(depth[i, j]), float(truth[i, j]))
        for i in range(truth.shape[0])
        for j in range(truth.shape[1])
        if 0 < truth[i, j] < math.inf and (mask is None or mask[i, j])
    ]
    if not pairs:
        return None
    n = len(pairs)
    off = [max(d / t, t / d) if d > 0 else math.inf for d, t in pairs]
    return {
        "abs_rel": sum(abs(d - t) / t for d, t in pairs) / n,
        "sq_rel": sum((d - t) ** 2 / t for d, t in pairs) / n,
        "rmse": math.sqrt(sum((d - t) ** 2 for d, t in pairs) / n),
        "delta1": sum(o < 1.25 for o in off) / n,
        "delta2": sum(o < 1.25**2 for o in off) / n,
        "delta3": sum(o < 1.25**3 for o in off) / n,
        "depth_share": n / truth.numel(),
    }


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 999), st.booleans())
def test_agrees_with_scalar_loops(height, width, seed, masked):
    depth, truth = depths(height, width, seed), depths(height, width, seed + 1)
    truth[truth > 3] = math.inf
    truth[truth < 0.7] = 0.0
    depth[depth < 0.8] = 0.0
    depth[truth == math.inf] = math.nan  # what does not count may be anything
    mask = random_mask(height, width, 0.6, seed) if masked else None
    got, want = depth_errors(depth, truth, mask), slow_errors(depth, truth, mask)
    if want is None:
        assert got.pop("depth_share") == 0
        assert all(math.isnan(value) for value in got.values())
    else:
        assert got == pytest.approx(want, rel=1e-9)


def test_worked_by_hand():
    truth = torch.tensor([[1.0, 2.0, 4.0, math.inf]])
    depth = torch.tensor([[1.2, 3.0, 2.0, 7.0]])  # factors 1.2, 1.5, 2 of 1.25, 1.5625, 1.953
    assert depth_errors(depth, truth) == pytest.approx(
        {
            "abs_rel": (0.2 + 0.5 + 0.5) / 3,
            "sq_rel": (0.04 + 0.5 + 1) / 3,
            "rmse": math.sqrt((0.04 + 1 + 4) / 3),
            "delta1": 1 / 3,
            "delta2": 2 / 3,
            "delta3": 2 / 3,
            "depth_share": 0.75,
        },
        rel=1e-6,
    )


def test_a_factor_of_exactly_the_bound_is_outside():
    assert depth_errors(torch.tensor([[5.0]]), torch.tensor([[4.0]]))["delta1"] == 0
    assert depth_errors(torch.tensor([[4.0]]), torch.tensor([[5.0]]))["delta1"] == 0


@given(st.integers(0, 999), st.floats(0.1, 100))
def test_perfect_depth_and_scale(seed, scale):
    truth = depths(5, 6, seed)
    assert depth_errors(truth, truth) == {
        "abs_rel": 0, "sq_rel": 0, "rmse": 0, "delta1": 1, "delta2": 1, "delta3": 1,
        "depth_share": 1,
    }  # fmt: skip
    depth = depths(5, 6, seed + 1)
    one, other = depth_errors(depth, truth), depth_errors(scale * depth, scale * truth)
    assert other["abs_rel"] == pytest.approx(one["abs_rel"])
    assert other["sq_rel"] == pytest.approx(scale * one["sq_rel"])
    assert other["rmse"] == pytest.approx(scale * one["rmse"])
    assert one["delta1"] <= one["delta2"] <= one["delta3"]


def test_depth_is_not_fitted_to_the_truth():
    truth = depths(5, 6, 0)
    assert depth_errors(2 * truth, truth)["abs_rel"] == pytest.approx(1)
    assert depth_errors(2 * truth, truth)["delta3"] == 0


def test_where_nothing_is_drawn_every_measure_suffers():
    truth = torch.full((1, 2), 2.0)
    got = depth_errors(torch.tensor([[2.0, 0.0]]), truth)
    assert got["delta3"] == got["abs_rel"] == 0.5
    assert got["rmse"] == pytest.approx(math.sqrt(2))


def test_bad_depths_are_refused_with_where():
    truth = depths(3, 4, 0)
    for bad in (math.nan, math.inf, -1.0):
        depth = truth.clone()
        depth[2, 1] = bad
        with pytest.raises(DataError, match=r"depth: \S+ at row 2, column 1 \(1 such"):
            depth_errors(depth, truth)
        everywhere_else = torch.ones(3, 4, dtype=torch.bool)
        everywhere_else[2, 1] = False
        assert depth_errors(depth, truth, everywhere_else)["abs_rel"] == 0
    with pytest.raises(DataError, match="true depth: nan at row 0, column 0"):
        depth_errors(truth, truth * math.nan)
