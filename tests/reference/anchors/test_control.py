from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.reference.anchors import control as ac
from splatproof.reference.anchors import sparse_convolution

D = torch.float64
S = ac.GrowthSettings(gradient=1.0, density=3.0)
NONE = torch.zeros(0, 3, dtype=D)
"""No anchors so far."""


def cloud(m: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    return torch.randn(m, 3, generator=g, dtype=D), torch.rand(m, generator=g, dtype=D) * 2


@given(m=st.integers(0, 50), seed=st.integers(0, 2**16), voxel=st.floats(0.1, 3))
@settings(max_examples=40)
def test_statistics_and_growth_by_loop(m, seed, voxel):
    positions, gradients = cloud(m, seed)
    cells: dict[tuple, list[int]] = {}
    for i in range(m):
        cells.setdefault(tuple((positions[i] / voxel).floor().long().tolist()), []).append(i)
    got = ac.voxel_statistics(positions, gradients, voxel)
    assert [tuple(c) for c in got.cells.tolist()] == sorted(cells)
    want: list[tuple] = []
    for row, key in enumerate(sorted(cells)):
        members = cells[key]
        mean = float(gradients[members].mean())
        assert float(got.density[row]) == len(members)
        assert float(got.gradient[row]) == pytest.approx(mean)
        if mean >= 1 and len(members) < 3:
            want.append(tuple((c + 0.5) * voxel for c in key))
        if mean >= 1 and len(members) >= 3:
            half = voxel / 2
            parts = {tuple((positions[i] / half).floor().tolist()) for i in members}
            want += [tuple((c + 0.5) * half for c in part) for part in parts]
    centres = ac.new_anchors(NONE, positions, got, voxel, S)
    assert sorted(map(tuple, centres.tolist())) == [pytest.approx(x) for x in sorted(want)]


def test_high_gradient_alone_grows_fewer_than_with_density():
    spread = torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9], [0.1, 0.9, 0.1]], dtype=D)
    steep = torch.full((3,), 5.0, dtype=D)
    few = ac.new_anchors(NONE, spread[:2], ac.voxel_statistics(spread[:2], steep[:2], 1.0), 1.0, S)
    many = ac.new_anchors(NONE, spread, ac.voxel_statistics(spread, steep, 1.0), 1.0, S)
    flat = ac.new_anchors(NONE, spread, ac.voxel_statistics(spread, steep * 0.1, 1.0), 1.0, S)
    assert few.tolist() == [[0.5, 0.5, 0.5]]
    assert len(many) == 3
    assert len(flat) == 0


@given(n=st.integers(0, 12), m=st.integers(0, 60), seed=st.integers(0, 2**16), s=st.booleans())
@settings(max_examples=40)
def test_growth_never_makes_an_anchor_where_one_stands(n, m, seed, s):
    """Grown twice from the same statistics, the second time adds nothing; and no twins."""
    voxel, edge = 0.5, 0.25
    wanted = replace(S, gradient=0.0) if s else S
    positions, gradients = cloud(m, seed)
    statistics = ac.voxel_statistics(positions, gradients, voxel)
    drawn = sparse_convolution.voxelise(cloud(n, seed + 1)[0], edge)
    anchors = (torch.unique(drawn, dim=0).to(D) + 0.3) * edge
    new = ac.new_anchors(anchors, positions, statistics, voxel, wanted)
    both = torch.cat([anchors, new])
    sparse_convolution.neighbours(sparse_convolution.voxelise(both, edge))  # refuses twins
    assert len(ac.new_anchors(both, positions, statistics, voxel, wanted)) == 0
    # Nothing but the anchors that stand keeps a cell from growing.
    fresh = {tuple(x) for x in ac.new_anchors(NONE, positions, statistics, voxel, wanted).tolist()}
    assert {tuple(x) for x in new.tolist()} <= fresh
    for centre in fresh - {tuple(x) for x in new.tolist()}:
        corner = min(abs(c / voxel % 1 - 0.5) for c in centre) < 1e-9  # centre of a whole voxel
        size = voxel if corner else edge
        cell = (torch.tensor(centre, dtype=D) / size).floor()
        assert ((anchors / size).floor() == cell).all(dim=1).any()


def test_growth_in_time_begins_at_its_own_threshold():
    always = replace(S, temporal_gradient=2.0, temporal_share=1.0)
    gradient = torch.tensor([1.9, 2.0, 2.1], dtype=D)
    grown = ac.temporal_growth(gradient, always, torch.Generator().manual_seed(0))
    assert grown.tolist() == [False, True, True]


def test_growth_in_time_is_a_seeded_share_of_the_steep():
    gradient = torch.full((8000,), 1.0, dtype=D)
    gradient[:4000] = 0.0
    grown = ac.temporal_growth(gradient, S, torch.Generator().manual_seed(0))
    assert not grown[:4000].any()
    # Binomial: standard deviation sqrt(0.1875 / 4000) = 0.0068; four of them.
    assert float(grown[4000:].double().mean()) == pytest.approx(0.25, abs=0.028)
    assert torch.equal(grown, ac.temporal_growth(gradient, S, torch.Generator().manual_seed(0)))


@given(visits=st.lists(st.booleans(), max_size=20))
def test_record_counts_iterations_since_the_last_visit(visits):
    record = torch.zeros(1, dtype=torch.long)
    for seen in visits:
        record = ac.update_unvisited(record, torch.tensor([seen]))
    since = visits[::-1].index(True) if True in visits else len(visits)
    assert int(record) == since


def test_pruning_by_hand():
    opacity = torch.tensor([0.004, 0.005, 0.9, 0.9, torch.nan], dtype=D)
    record = torch.tensor([0, 0, 500, 501, 3])
    assert ac.keep(opacity, record, 250, ac.GrowthSettings()).tolist() == [
        False, True, True, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize("views", [3, 400])
def test_an_anchor_that_one_view_sees_survives_any_order_of_the_views(views):
    """First of one pass, last of the next: the longest wait that drawing without return allows."""
    record = torch.zeros(1, dtype=torch.long)
    for step in range(2 * views):
        seen = step in (0, 2 * views - 1)
        record = ac.update_unvisited(record, torch.tensor([seen]))
        assert ac.keep(torch.ones(1, dtype=D), record, views, replace(S, unvisited=1)).all()
    for _ in range(2 * views + 1):
        record = ac.update_unvisited(record, torch.tensor([False]))
    assert not ac.keep(torch.ones(1, dtype=D), record, views, replace(S, unvisited=1)).any()


def test_nothing_to_grow_or_prune():
    positions, gradients = cloud(0, 0)
    statistics = ac.voxel_statistics(positions, gradients, 1.0)
    assert len(ac.new_anchors(NONE, positions, statistics, 1.0, S)) == 0
    assert_close(ac.update_unvisited(torch.zeros(0, dtype=torch.long), torch.zeros(0).bool()),
                 torch.zeros(0, dtype=torch.long))  # fmt: skip
