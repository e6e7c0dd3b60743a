"""CityGaussian's grid: contraction, one owner for each point, the views a block needs."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError
from splatproof.reference.partition import contracted_grid as grid
from splatproof.reference.partition.boxes import Box

SEEDS = st.integers(0, 2**16)
CELLS = st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 2))
D = torch.float64
BOX = Box(low=torch.tensor([-4.0, 0, 10], dtype=D), high=torch.tensor([4.0, 2, 11], dtype=D))


def far_points(count: int, seed: int) -> Tensor:
    """Points inside the box, around it, and up to 1e8 sizes away."""
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(count, 3, generator=generator, dtype=D)
    return direction * 10 ** (8 * torch.rand(count, 1, generator=generator, dtype=D) ** 3)


@settings(max_examples=40)
@given(count=st.integers(0, 30), seed=SEEDS)
def test_contraction_is_bounded_and_undone(count, seed):
    points = far_points(count, seed)
    unit = grid.contract(points, BOX)
    assert ((unit >= 0) & (unit <= 1)).all()
    # 1 - u' is 1/m of 4: what comes back carries the rounding of 1/m, m times over.
    away = points.abs().amax(dim=1, keepdim=True).clamp(min=1)
    assert ((grid.expand(unit, BOX) - points).abs() <= 1e-13 * away**2 + 1e-12).all()


def test_contraction_by_hand():
    # u = (1, 0, 0) is the box's wall; u = (2, 1, 0) becomes (2 - 1/2) (1, 1/2, 0) = (1.5, .75, 0).
    points = torch.tensor([[4.0, 1, 10.5], [8, 2, 10.5], [0, 1, 10.5]], dtype=D)
    want = torch.tensor([[0.75, 0.5, 0.5], [0.875, 0.6875, 0.5], [0.5, 0.5, 0.5]], dtype=D)
    assert_close(grid.contract(points, BOX), want)


def test_value_and_slope_are_continuous_at_the_wall():
    step = 1e-6
    wall = torch.tensor([4.0, 1, 10.5], dtype=D)
    along = torch.tensor([1.0, 0, 0], dtype=D) * step
    before, at, after = grid.contract(torch.stack([wall - along, wall, wall + along]), BOX)[:, 0]
    assert_close(before, at, atol=step, rtol=0)
    # Slopes on both sides: 1/4 a half-size, i.e. 1/16 a unit; they differ by O(step).
    assert float((at - before) / step) == pytest.approx(1 / 16, rel=1e-5)
    assert float((after - at) / step) == pytest.approx(1 / 16, rel=1e-5)


@settings(max_examples=20)
@given(seed=SEEDS)
def test_contraction_is_monotone_along_rays(seed):
    ray = torch.randn(3, generator=torch.Generator().manual_seed(seed), dtype=D)
    middle = (BOX.low + BOX.high) / 2
    distances = torch.logspace(-3, 6, 50, dtype=D)[:, None]
    radius = (grid.contract(middle + distances * ray, BOX) - 0.5).norm(dim=1)
    assert (radius.diff() > 0).all()


def test_contraction_has_right_gradients():
    points = torch.tensor([[1.0, 0.5, 10.2], [9, 3, 12], [-30, 1, 10]], dtype=D)
    assert torch.autograd.gradcheck(lambda p: grid.contract(p, BOX), (points.requires_grad_(),))


@settings(max_examples=40)
@given(count=st.integers(0, 40), cells=CELLS, seed=SEEDS)
def test_each_point_is_in_exactly_one_cell(count, cells, seed):
    unit = grid.contract(far_points(count, seed), BOX)
    found = grid.cell_of(unit, cells)
    X, Y, Z = cells
    for point, cell in zip(unit.tolist(), found.tolist(), strict=True):
        index = [min(int(u * n), n - 1) for u, n in zip(point, cells, strict=True)]
        assert cell == index[2] * X * Y + index[1] * X + index[0]
        assert 0 <= cell < X * Y * Z


def test_a_coordinate_rounded_up_to_one_is_kept():
    assert grid.cell_of(torch.ones(1, 3), (3, 1, 2)).tolist() == [5]
    infinite = grid.contract(torch.tensor([[1e30, 1.0, 10.5]]), BOX)
    assert grid.cell_of(infinite, (3, 1, 1)).tolist() == [2]


@settings(max_examples=30)
@given(count=st.integers(0, 40), cells=CELLS, seed=SEEDS, enough=st.integers(0, 50))
def test_a_grown_cell_holds_enough_or_all(count, cells, seed, enough):
    unit = grid.contract(far_points(count, seed), BOX)
    last = cells[0] * cells[1] * cells[2] - 1
    held = grid.grown_cell(unit, cells, last, enough=enough)
    assert int(held.sum()) >= min(enough, count)
    assert held[grid.cell_of(unit, cells) == last].all()


@settings(max_examples=30)
@given(count=st.integers(0, 40), cells=CELLS, seed=SEEDS)
def test_what_is_strictly_inside_a_cell_is_owned_by_it(count, cells, seed):
    unit = grid.contract(far_points(count, seed), BOX)
    owner = grid.cell_of(unit, cells)
    inside = [grid.strictly_inside(unit, cells, c) for c in range(cells[0] * cells[1] * cells[2])]
    on_wall = ((unit * torch.tensor(cells)) % 1 == 0).any(dim=1)
    for cell, held in enumerate(inside):
        assert torch.equal(held, (owner == cell) & ~on_wall)
        assert grid.grown_cell(unit, cells, cell, enough=0)[owner == cell].all()


def test_views_come_by_position_or_by_change():
    # Cell 0 of two along x is (0, 1/2). On a wall is not inside.
    centres = torch.tensor([[0.2, 0.5, 0.5], [0.5, 0.5, 0.5], [0.9, 0.5, 0.5], [0.9, 0.5, 0.5]])
    change = {1: 0.1, 2: 0.3, 3: 0.05}
    found = grid.needed_views(centres, (2, 1, 1), 0, change.__getitem__, threshold=0.1)
    assert found.tolist() == [True, False, True, False]


@settings(max_examples=30)
@given(low=st.floats(0, 1), high=st.floats(0, 1), seed=SEEDS)
def test_a_larger_threshold_takes_fewer_views(low, high, seed):
    low, high = sorted((low, high))
    draw = torch.rand(12, 3, generator=torch.Generator().manual_seed(seed))
    few, many = (
        grid.needed_views(draw, (2, 2, 1), 1, lambda v: float(draw[v, 2]), threshold=t)
        for t in (high, low)
    )
    assert not (few & ~many).any()


def test_the_central_box_by_hand():
    points = torch.tensor([[-3.0, 0, 5], [-1, 0, 5], [0, 1, 5], [1, 2, 5], [99, 9, 5]], dtype=D)
    box = grid.central_box(points)
    # Medians (0, 1, 5); distances of x: 3 1 0 1 99 -> 1; of y: 1 1 0 1 8 -> 1; z flat: 1.
    assert box.low.tolist() == [-1, 0, 4]
    assert box.high.tolist() == [1, 2, 6]


@pytest.mark.parametrize("points", [torch.zeros(0, 3), torch.ones(4, 3)])
def test_no_central_box_without_extent(points):
    with pytest.raises(DataError):
        grid.central_box(points)


def test_a_foreground_without_volume_is_refused():
    flat = Box(low=torch.zeros(3), high=torch.tensor([1.0, 1, 0]))
    with pytest.raises(DataError, match="positive"):
        grid.contract(torch.zeros(1, 3), flat)
