"""Cloud distances against all pairs, and numbers worked by hand."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from splatproof.base.errors import DataError, UsageError
from splatproof.metrics.geometry import (
    GeometryScores,
    completeness,
    geometry_scores,
    vertical_faces,
)


def cloud(count: int, seed: int):
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def slow_scores(found, true, threshold, counts):
    """By the matrix of all distances."""
    all_pairs = cdist(found.numpy(), true.numpy())
    mine = counts[all_pairs.argmin(axis=1)]
    out, back = all_pairs.min(axis=1)[mine], all_pairs.min(axis=0)[counts]
    if not len(out):
        return math.nan, back.mean(), math.nan, (back <= threshold).mean(), 0.0
    precision, recall = (out <= threshold).mean(), (back <= threshold).mean()
    f_score = 0.0 if precision + recall == 0 else 2 * precision * recall / (precision + recall)
    return out.mean(), back.mean(), precision, recall, f_score


@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(0.01, 1.0),
    st.integers(0, 999),
    st.booleans(),
)
def test_agrees_with_all_pairs(n, m, threshold, seed, masked):
    found, true = cloud(n, seed), cloud(m, seed + 1)
    counted = None
    if masked:
        counted = cloud(m, seed + 2)[:, 0] < 0.5
        counted[0] = True
    counts = np.ones(m, dtype=bool) if counted is None else counted.numpy()
    got = geometry_scores(found, true, threshold, counted)
    want = slow_scores(found, true, threshold, counts)
    values = (
        got.accuracy, got.completeness_distance, got.precision, got.completeness, got.f_score
    )  # fmt: skip
    assert values == pytest.approx(want, nan_ok=True, abs=1e-12)
    assert got.chamfer == pytest.approx((want[0] + want[1]) / 2, nan_ok=True, abs=1e-12)
    assert completeness(found, true[torch.from_numpy(counts)], threshold) == got.completeness


def test_worked_by_hand():
    """Found at 0 and 3 on a line, true at 0, 1 and 2."""
    found = torch.tensor([[0.0, 0, 0], [3, 0, 0]])
    true = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert dataclasses.asdict(geometry_scores(found, true, 0.5)) == pytest.approx(
        {
            "accuracy": 0.5,  # 0 and 1
            "completeness_distance": 2 / 3,  # 0, 1 and 1
            "precision": 0.5,
            "completeness": 1 / 3,
            "f_score": 0.4,
            "chamfer": 7 / 12,
        }
    )
    facade = torch.tensor([False, False, True])
    got = geometry_scores(found, true, 1.0, facade)  # 3 belongs to 2, and 2 is nearest to 3
    assert (got.accuracy, got.completeness_distance, got.precision, got.completeness) == (
        1,
        1,
        1,
        1,
    )


@given(st.integers(1, 30), st.integers(0, 999))
def test_equal_clouds_are_perfect_in_any_order(count, seed):
    points = cloud(count, seed)
    assert geometry_scores(points.flip(0), points, 1e-6) == GeometryScores(
        accuracy=0.0, completeness_distance=0.0, precision=1.0, completeness=1.0, f_score=1.0,
        chamfer=0.0,
    )  # fmt: skip


@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 999), st.floats(0.1, 100))
def test_swapping_the_clouds_swaps_the_directions_and_scale_scales(n, m, seed, scale):
    found, true = cloud(n, seed), cloud(m, seed + 1)
    got, back = geometry_scores(found, true, 0.2), geometry_scores(true, found, 0.2)
    assert got.accuracy == pytest.approx(back.completeness_distance)
    assert got.precision == back.completeness
    assert got.f_score == pytest.approx(back.f_score)
    assert got.chamfer == pytest.approx(back.chamfer)
    larger = geometry_scores(scale * found, scale * true, 0.2 * scale)
    assert larger.chamfer == pytest.approx(scale * got.chamfer)


def test_far_from_the_origin_nothing_is_lost():
    """UTM eastings in float64: the same distances to 1e-9 of the offset's rounding."""
    found, true = cloud(50, 0), cloud(60, 1)
    shift = torch.tensor([5e5, 4e6, 100.0], dtype=torch.float64)
    near, far = geometry_scores(found, true, 0.1), geometry_scores(found + shift, true + shift, 0.1)
    assert far.chamfer == pytest.approx(near.chamfer, abs=4e-9)


def test_the_threshold_is_included():
    found, true = torch.zeros(1, 3), torch.tensor([[0.25, 0.0, 0.0]])
    assert geometry_scores(found, true, 0.25).f_score == 1
    assert geometry_scores(found, true, 0.2499).f_score == 0
    assert completeness(found, true, 0.25) == 1
    assert completeness(found, true, 0.2499) == 0


def test_nothing_reconstructed():
    got = geometry_scores(torch.zeros(0, 3), cloud(5, 0), 0.1)
    assert (got.completeness, got.f_score, got.chamfer) == (0, 0, math.inf)
    assert math.isnan(got.accuracy)
    assert completeness(torch.zeros(0, 3), cloud(5, 0), 0.1) == 0


def test_only_facades_that_nothing_is_near():
    """All found points belong to the ground: the facade has no accuracy and is not complete."""
    true = torch.tensor([[0.0, 0, 0], [0, 0, 50]])
    got = geometry_scores(torch.zeros(4, 3), true, 1.0, torch.tensor([False, True]))
    assert math.isnan(got.accuracy)
    assert math.isnan(got.precision)
    assert (got.completeness, got.completeness_distance, got.f_score) == (0, 50, 0)


def test_bad_input_is_refused():
    points = cloud(5, 0)
    bad = points.clone()
    bad[3, 1] = math.nan
    with pytest.raises(DataError, match="no point counts"):
        geometry_scores(points, points, 0.1, torch.zeros(5, dtype=torch.bool))
    for scores in (geometry_scores, completeness):
        with pytest.raises(
            DataError, match=r"reconstruction: point 3 is .*nan.* \(1 such points\)"
        ):
            scores(bad, points, 0.1)
        with pytest.raises(DataError, match="reference: point 3"):
            scores(points, bad, 0.1)
        with pytest.raises(DataError, match="no point counts"):
            scores(points, points[:0], 0.1)
        for threshold in (0.0, -1.0, math.nan, math.inf):
            with pytest.raises(UsageError, match="threshold"):
                scores(points, points, threshold)


def test_vertical_faces_by_angle():
    up = torch.tensor([0.0, 0.0, 1.0])
    tilts = [0, 10, 19.9, 20.1, 45, 90]  # degrees of the surface from vertical
    normals = torch.tensor(
        [[math.cos(math.radians(t)), 0.0, math.sin(math.radians(t))] for t in tilts]
    )
    want = [True, True, True, False, False, False]
    assert vertical_faces(normals, up).tolist() == want
    assert vertical_faces(-normals, up).tolist() == want
    assert vertical_faces(normals, up, most_degrees=50.0).tolist() == [True] * 5 + [False]
