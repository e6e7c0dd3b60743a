"""Boxes: widening, the normalised distance against rotated corners, refusals."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError
from splatproof.reference.partition import boxes
from splatproof.reference.partition.boxes import Box, OrientedBox
from splatproof.reference.rasterizer.rotation import rotation_matrix

SEEDS = st.integers(0, 2**16)


def uniform(*shape: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=torch.float64)


def oriented(seed: int) -> OrientedBox:
    q, c, e = uniform(1, 4, seed=seed) - 0.5, uniform(3, seed=seed + 1), uniform(3, seed=seed + 2)
    return OrientedBox(centre=9 * c, rotation=rotation_matrix(q)[0], half=e + 0.1)


def test_widening_by_hand():
    # 0.2 of a side of 10 is 2: one on each side.
    core = Box(low=torch.tensor([0.0, -5, 2]), high=torch.tensor([10.0, 5, 2]))
    wide = boxes.widen(core, 0.2)
    assert wide.low.tolist() == [-1, -6, 2]
    assert wide.high.tolist() == [11, 6, 2]


@settings(max_examples=30)
@given(count=st.integers(1, 40), seed=SEEDS)
def test_bounds_hold_their_points_and_no_smaller_box_does(count, seed):
    points = uniform(count, 3, seed=seed)
    core = boxes.bounds(points)
    assert boxes.inside(core, points).all()
    assert torch.equal(core.low, points.min(dim=0).values)
    assert torch.equal(core.high, points.max(dim=0).values)
    assert boxes.inside(boxes.widen(core, 0.2), points).all()


@settings(max_examples=30)
@given(seed=SEEDS)
def test_corners_are_at_distance_one_and_centre_at_zero(seed):
    box = oriented(seed)
    around = boxes.corners(box)
    assert_close(boxes.box_distance(box, around), torch.ones(8, dtype=torch.float64))
    assert_close(around.mean(dim=0), box.centre)
    assert_close(boxes.box_distance(box, box.centre[None]), torch.zeros(1, dtype=torch.float64))
    assert len(around.round(decimals=9).unique(dim=0)) == 8
    local = (around - box.centre) @ box.rotation.T
    for i in range(8):
        assert (local[i] > 0).tolist() == [bool(i >> axis & 1) for axis in range(3)]


@settings(max_examples=30)
@given(seed=SEEDS, count=st.integers(0, 20))
def test_distance_is_the_scale_at_which_the_box_reaches_the_point(seed, count):
    box = oriented(seed)
    points = 12 * uniform(count, 3, seed=seed + 3)
    scale = boxes.box_distance(box, points)
    for point, at in zip(points, scale.tolist(), strict=True):
        # By plain trigonometry: the largest of |axis . (p - c)| / e over the three axes.
        offsets = [float(abs(axis @ (point - box.centre))) for axis in box.rotation]
        assert at == pytest.approx(
            max(o / float(e) for o, e in zip(offsets, box.half, strict=True))
        )


def test_distance_by_hand_on_a_turned_box():
    # Turned by 90 degrees about z: the box's first axis is the world's y.
    turn = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    box = OrientedBox(centre=torch.zeros(3), rotation=turn, half=torch.tensor([4.0, 2, 1]))
    points = torch.tensor([[0.0, 4, 0], [1, 0, 0], [3, 0, 0], [0, 0, 2]])
    assert boxes.box_distance(box, points).tolist() == [1, 0.5, 1.5, 2]


def test_a_margin_shrinks_distances_by_as_much():
    box = oriented(3)
    points = 9 * uniform(10, 3, seed=9)
    wide = boxes.widen_oriented(box, 0.25)
    assert_close(boxes.box_distance(wide, points) * 1.25, boxes.box_distance(box, points))
    region = boxes.WidenedRegion(region=box, margin=0.25)
    assert_close(region.distance(points), wide.distance(points))
    assert torch.equal(region.centre, box.centre)


@pytest.mark.parametrize("half", [[1.0, 0, 1], [1.0, -1, 1], [1.0, float("nan"), 1], [0.0, 0, 0]])
def test_a_box_without_volume_is_refused(half):
    with pytest.raises(DataError, match="half-extents"):
        OrientedBox(centre=torch.zeros(3), rotation=torch.eye(3), half=torch.tensor(half))


def test_a_box_around_nothing_is_refused():
    with pytest.raises(DataError, match="no points"):
        boxes.bounds(torch.zeros(0, 3))
