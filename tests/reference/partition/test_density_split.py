"""BlockGaussian's recursion: rectangles tile the root, every point has one owner."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition import density_split as density
from splatproof.reference.partition.boxes import box_distance
from splatproof.reference.partition.density_split import DensitySettings

SEEDS = st.integers(0, 2**16)
D = torch.float64


def uniform(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=D)


def recursion(local: Tensor, low: Tensor, high: Tensor, depth: int, most: int) -> list[list[float]]:
    """Leaves as plain recursion gives them: halve the longer edge while too full and not too deep."""
    if len(local) <= most or depth == 0:
        return [low.tolist() + high.tolist()]
    axis = 0 if high[0] - low[0] >= high[1] - low[1] else 1
    middle = (low[axis] + high[axis]) / 2
    end, start = high.clone(), low.clone()
    end[axis] = start[axis] = middle
    below = local[:, axis] < middle
    return recursion(local[below], low, end, depth - 1, most) + recursion(
        local[~below], start, high, depth - 1, most
    )


@settings(max_examples=40)
@given(count=st.integers(1, 80), seed=SEEDS, most=st.integers(1, 30), depth=st.integers(0, 4))
def test_fullest_first_gives_what_recursion_gives(count, seed, most, depth):
    ground = uniform(count, 2, seed=seed) ** 3  # crowded towards one corner
    found = density.split(ground, DensitySettings(max_points=most, max_depth=depth))
    local = density.along(ground, found.axes)
    want = recursion(local, found.root[0], found.root[1], depth, most)
    leaves = torch.cat([found.lows, found.highs], dim=1).tolist()
    assert sorted(leaves) == sorted(want)


@settings(max_examples=40)
@given(count=st.integers(1, 80), seed=SEEDS, blocks=st.integers(1, 9))
def test_rectangles_tile_the_root_and_own_every_point_once(count, seed, blocks):
    ground = uniform(count, 2, seed=seed)
    found = density.split(ground, DensitySettings(max_points=0, max_depth=8, max_blocks=blocks))
    sizes = found.highs - found.lows
    assert_close(sizes.prod(dim=1).sum(), (found.root[1] - found.root[0]).prod())
    owner = density.owner_rectangle(found, ground)
    assert ((owner >= 0) & (owner < len(found.lows))).all()
    local = density.along(ground, found.axes)
    assert (local >= found.lows[owner]).all()
    assert (local <= found.highs[owner]).all()
    if count > 1:
        assert len(found.lows) == blocks
    assert density.owner_rectangle(found, ground + 9).tolist() == [-1] * count


CORNERS = torch.tensor([[0.0, 0], [4, 0], [0, 2], [4, 2]], dtype=D)


def along_first(points: Tensor, settings: DensitySettings) -> tuple[Tensor, Tensor, Tensor]:
    """Lows, highs and the points along the root's longer edge, from 0 to 4 whichever way it runs."""
    found = density.split(points, settings)
    axis = int((found.root[1] - found.root[0]).argmax())
    start = found.root[0, axis]
    local = density.along(points, found.axes)[:, axis]
    return found.lows[:, axis] - start, found.highs[:, axis] - start, local - start


@pytest.mark.parametrize("crowd", [0.5, 3.5])
def test_points_on_shared_edges_belong_above(crowd):
    # On the middle line, with the crowd once below and once above it, so that either half is first.
    more = torch.tensor([[2.0, 1], [crowd, 1], [crowd, 1.5], [crowd, 0.5]], dtype=D)
    ground = torch.cat([CORNERS, more])
    settings = DensitySettings(max_points=1, max_depth=1)
    lows, _, local = along_first(ground, settings)
    owner = density.owner_rectangle(density.split(ground, settings), ground)
    assert float(local[4]) == 2
    assert float(lows[owner[4]]) == 2


def test_points_on_the_middle_line_count_above():
    # Three on the line: 2 below and 5 above, so only the upper half is too full for 4.
    line = torch.tensor([[2.0, 0.5], [2, 1], [2, 1.5]], dtype=D)
    lows, highs, _ = along_first(
        torch.cat([CORNERS, line]), DensitySettings(max_points=4, max_depth=2)
    )
    assert len(lows) == 3
    assert [(float(a), float(b)) for a, b in zip(lows, highs, strict=True)].count((0, 2)) == 1


def test_the_fullest_rectangle_is_halved_first():
    # Ten points in one half, none but corners in the other; of three blocks that one stays whole.
    crowd = torch.tensor([0.5, 0.3], dtype=D) + uniform(10, 2, seed=0)
    settings = DensitySettings(max_points=0, max_depth=9, max_blocks=3)
    lows, highs, local = along_first(torch.cat([CORNERS, crowd]), settings)
    assert len(lows) == 3
    whole = int((highs - lows).argmax())
    assert float(highs[whole] - lows[whole]) == 2
    inside = (local >= lows[whole]) & (local < highs[whole])
    assert not inside[4:].any()


@settings(max_examples=30)
@given(count=st.integers(3, 40), seed=SEEDS, angle=st.floats(0, math.pi))
def test_turning_the_scene_turns_the_rectangles(count, seed, angle):
    ground = uniform(count, 2, seed=seed) * torch.tensor([3.0, 1])
    turn = torch.tensor(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=D
    )
    axes, corners = density.smallest_rectangle(ground)
    turned_axes, turned = density.smallest_rectangle(ground @ turn.T)
    assert_close((turned[1] - turned[0]).prod(), (corners[1] - corners[0]).prod())
    assert_close(axes @ axes.T, torch.eye(2, dtype=D))
    local = density.along(ground @ turn.T, turned_axes)
    assert (local >= turned[0]).all()
    assert (local <= turned[1]).all()


@settings(max_examples=20)
@given(count=st.integers(3, 30), seed=SEEDS)
def test_no_turned_rectangle_is_smaller(count, seed):
    ground = uniform(count, 2, seed=seed)
    _, corners = density.smallest_rectangle(ground)
    least = float((corners[1] - corners[0]).prod())
    for angle in torch.linspace(0, math.pi / 2, 91, dtype=D).tolist():
        axes = torch.tensor(
            [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]], dtype=D
        )
        local = ground @ axes.T
        assert float((local.amax(dim=0) - local.amin(dim=0)).prod()) >= least - 1e-12


@pytest.mark.parametrize(
    "ground",
    [torch.ones(9, 2), torch.ones(1, 2), torch.arange(12.0)[:, None].repeat(1, 2)],
    ids=["coincident", "one", "line"],
)
def test_points_without_area_end_the_recursion(ground):
    found = density.split(ground, DensitySettings(max_points=1, max_depth=3))
    owner = density.owner_rectangle(found, ground)
    assert (owner >= 0).all()
    assert len(found.lows) <= 8


def test_no_points_are_refused():
    with pytest.raises(DataError, match="no points"):
        density.split(torch.zeros(0, 2), DensitySettings())
    with pytest.raises(DataError, match="no points"):
        density.height_bounds(torch.zeros(0))


@pytest.mark.parametrize("wrong", [{"max_depth": -1}, {"max_blocks": 0}])
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(UsageError):
        density.split(torch.ones(2, 2), DensitySettings(**wrong))


def test_height_bounds_by_hand():
    # Percentiles 1 and 99 of 0, 1, ..., 100 are 1 and 99; 20 % of 98 is 19.6 on each side.
    low, high = density.height_bounds(torch.arange(101.0))
    assert low == pytest.approx(1 - 19.6)
    assert high == pytest.approx(99 + 19.6)
    # The merge keeps 1.2 times the extent: half of 137.2 * 1.2 = 82.32 around 50.
    kept = density.keeps_height(torch.tensor([-32.3, -32.4, 132.3, 132.4]), (low, high))
    assert kept.tolist() == [True, False, True, False]


@settings(max_examples=20)
@given(count=st.integers(4, 60), seed=SEEDS)
def test_oriented_boxes_hold_what_their_rectangles_own(count, seed):
    points = uniform(count, 3, seed=seed)
    frame = torch.linalg.qr(uniform(3, 3, seed=seed + 1))[0]
    frame = frame * torch.linalg.det(frame)
    upright = points @ frame.T
    found = density.split(upright[:, :2], DensitySettings(max_points=0, max_depth=3, max_blocks=4))
    owner = density.owner_rectangle(found, upright[:, :2])
    heights = float(upright[:, 2].min()) - 1, float(upright[:, 2].max()) + 1
    for block, box in enumerate(density.oriented_boxes(found, frame, heights)):
        held = box_distance(box, points) <= 1 + 1e-9
        assert held[owner == block].all()
        # Exact rectangles: what it does not own lies outside, or on a shared edge.
        assert (box_distance(box, points)[owner != block] >= 1 - 1e-9).all()


def test_a_rectangle_without_area_gives_no_box():
    line = density.split(torch.arange(8.0)[:, None].repeat(1, 2), DensitySettings())
    with pytest.raises(DataError, match="half-extents"):
        density.oriented_boxes(line, torch.eye(3, dtype=D), (0.0, 1.0))
