"""ODBP: owners, loads, invariances, and what happens when balance is out of reach."""

import networkx
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from helpers.clouds import cloud
from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition import metis, odbp
from splatproof.reference.partition.odbp import OdbpPartition, OdbpSettings

SEEDS = st.integers(0, 2**16)


def cut(positions: Tensor, loads: Tensor, blocks: int, **settings: float) -> OdbpPartition:
    return odbp.partition(
        positions, loads, OdbpSettings(blocks=blocks, voxel_size=1.0, seeds=3, **settings)
    )  # fmt: skip


def load_sums(labels: Tensor, loads: Tensor, blocks: int) -> list[int]:
    return [int(loads[labels == block].sum()) for block in range(blocks)]


@settings(max_examples=20)
@given(count=st.integers(0, 120), blocks=st.integers(1, 6), seed=SEEDS, heavy=st.booleans())
def test_every_point_has_one_owner_and_no_block_is_empty(count, blocks, seed, heavy):
    positions, loads = cloud(count, seed)
    if heavy and count:
        loads[0] = 1000
    if blocks > max(1, len(positions.unique(dim=0))):
        with pytest.raises(DataError, match="distinct"):
            cut(positions, loads, blocks)
        return
    found = cut(positions, loads, blocks)
    assert found.labels.shape == (count,)
    assert count == 0 or found.labels.unique().tolist() == list(range(blocks))
    assert found.loads.tolist() == load_sums(found.labels, loads, blocks)
    first = [found.voxel_labels.tolist().index(block) for block in range(blocks) if count]
    assert first == sorted(first)
    assert found.edge_cut == metis.cut_size(found.graph.all_edges, found.voxel_labels)
    assert torch.equal(odbp.owner(found, positions), found.labels)


@settings(max_examples=10)
@given(blocks=st.integers(2, 8), imbalance=st.sampled_from([0.01, 0.05]), seed=SEEDS)
def test_loads_are_within_the_bound_where_points_are_light(blocks, imbalance, seed):
    # 6,000 points with at most 9 each against a mean of >= 3,300: the heaviest point is under 1 %.
    positions, loads = cloud(6000, seed, cells=24)
    found = cut(positions, loads, blocks, imbalance=imbalance)
    assert found.balanced
    mean = float(loads.sum()) / blocks
    assert all(abs(load / mean - 1) <= imbalance for load in found.loads.tolist())
    assert found.worst == pytest.approx(max(abs(x / mean - 1) for x in found.loads.tolist()))


@pytest.mark.parametrize("blocks", [2, 5])
def test_slabs_keep_the_bound_where_no_cut_of_metis_does(blocks, monkeypatch):
    def lopsided(graph, settings):
        """All of it to the last block but a voxel for each of the others."""
        return np.minimum(np.arange(len(graph.weights)), settings.blocks - 1)

    monkeypatch.setattr(odbp, "smallest_cut", lopsided)
    positions, loads = cloud(6000, 1, cells=24)
    found = cut(positions, loads, blocks, imbalance=0.05)
    assert found.balanced
    assert found.worst <= 0.05
    assert found.labels.unique().tolist() == list(range(blocks))


@settings(max_examples=15)
@given(blocks=st.integers(2, 6), seed=SEEDS)
def test_blocks_are_connected_through_edges_and_bridges(blocks, seed):
    positions, loads = cloud(1500, seed, cells=12)
    found = cut(positions, loads, blocks)
    graph = networkx.Graph(list(map(tuple, found.graph.all_edges.tolist())))
    parts = [np.where(found.voxel_labels == block)[0].tolist() for block in range(blocks)]
    assert found.contiguous
    assert all(networkx.is_connected(graph.subgraph(voxels)) for voxels in parts)
    # A voxel that changes places with one from the far end tears its block apart.
    torn = found.voxel_labels.copy()
    torn[[0, -1]] = torn[[-1, 0]]
    pieces = sum(
        networkx.number_connected_components(graph.subgraph(np.where(torn == b)[0].tolist()))
        for b in range(blocks)
    )
    assert odbp.connected_pieces(found.graph, torn) == pieces > blocks


@settings(max_examples=12)
@given(count=st.integers(20, 150), blocks=st.integers(1, 5), seed=SEEDS)
def test_order_of_points_and_unit_of_loads_change_nothing(count, blocks, seed):
    positions, loads = cloud(count, seed)
    found = cut(positions, loads, blocks)
    order = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
    assert torch.equal(cut(positions[order], loads[order], blocks).labels, found.labels[order])
    assert torch.equal(cut(positions, 2 * loads, blocks).labels, found.labels)


@settings(max_examples=12)
@given(count=st.integers(20, 150), power=st.integers(-3, 3), shift=st.integers(-99, 99), seed=SEEDS)
def test_moving_and_scaling_scene_and_voxel_changes_nothing(count, power, shift, seed):
    positions, loads = cloud(count, seed)
    found = cut(positions, loads, 3)
    scale = 2.0**power  # exact in floating point, as is the shift on the lattice
    moved = odbp.partition(
        (positions + shift) * scale, loads, OdbpSettings(blocks=3, voxel_size=scale, seeds=3)
    )
    assert torch.equal(moved.labels, found.labels)
    assert torch.equal(odbp.owner(moved, (positions + shift) * scale), found.labels)


@given(count=st.integers(0, 30), seed=SEEDS)
@settings(max_examples=20)
def test_one_block_is_the_whole_scene(count, seed):
    positions, loads = cloud(count, seed)
    found = cut(positions, loads, 1)
    assert found.balanced
    assert found.edge_cut == 0
    assert not found.labels.any()


def test_two_islands_are_cut_at_their_bridge():
    # Two 3 x 3 islands of equal load, far apart: the one cut edge is the bridge between them.
    lattice = torch.cartesian_prod(torch.arange(3.0), torch.arange(3.0), torch.zeros(1)).double()
    positions = torch.cat([lattice, lattice + torch.tensor([50.0, 0, 0])])
    found = cut(positions, torch.full((18,), 5), 2, imbalance=0.001)
    assert found.labels.tolist() == [0] * 9 + [1] * 9
    assert found.loads.tolist() == [45, 45]
    assert found.edge_cut == 1
    assert len(found.graph.bridges) == 1


def test_metis_finds_the_smallest_cut_of_a_dumbbell():
    # Two cliques of four joined by one edge: the best bisection cuts just that edge.
    pairs = [
        (a, b) for side in (0, 4) for a in range(side, side + 4) for b in range(a + 1, side + 4)
    ]
    edges = np.array([*pairs, (3, 4)], dtype=np.int64)
    labels = metis.cut_graph(np.ones(8, dtype=np.int64), edges, 2, imbalance=0.01, seed=0)
    assert len(set(labels[:4].tolist())) == len(set(labels[4:].tolist())) == 1
    assert metis.cut_size(edges, labels) == 1


@settings(max_examples=8)
@given(blocks=st.integers(2, 6), seed=SEEDS, cells=st.sampled_from([12, 28]))
def test_the_smallest_cut_of_the_balanced_runs_is_kept(blocks, seed, cells):
    positions, loads = cloud(1500, seed, cells=cells)  # in 28 x 28 cells the cloud is in pieces
    graph = cut(positions, loads, 1).graph
    asked = OdbpSettings(blocks=blocks, voxel_size=1.0, imbalance=0.01, seeds=6)
    found = odbp.smallest_cut(graph, asked)

    def rank(labels: np.ndarray) -> tuple[float, bool, int]:
        sums = np.bincount(labels, weights=graph.weights, minlength=blocks)
        over = max(float(np.abs(sums / sums.mean() - 1).max()), 0.01)
        torn = odbp.connected_pieces(graph, labels) > blocks
        return over, torn, metis.cut_size(graph.all_edges, labels)

    runs = [
        metis.cut_graph(
            graph.weights, graph.all_edges, blocks, imbalance=0.01, seed=run, contiguous=joined
        )
        for run in range(6)
        for joined in (True, False)
    ]
    assert rank(found) == min(map(rank, runs))


def test_metis_keeps_parts_connected_when_asked():
    torn = []
    for seed in range(6):
        positions, loads = cloud(500, seed, cells=28)
        graph = cut(positions, loads + 1, 1).graph
        for asked in (True, False):
            labels = metis.cut_graph(
                graph.weights, graph.all_edges, 4, imbalance=0.05, seed=seed, contiguous=asked
            )
            torn.append((asked, odbp.connected_pieces(graph, labels) > 4))
    assert (True, True) not in torn
    assert (False, True) in torn  # else this test could not fail


@pytest.mark.parametrize("imbalance", [0.01, 0.1])
def test_metis_keeps_loads_under_its_bound_on_a_lattice(imbalance):
    cells = torch.cartesian_prod(
        torch.arange(20), torch.arange(20), torch.zeros(1, dtype=torch.int64)
    )
    graph = cut(cells.double(), torch.ones(400, dtype=torch.int64), 1).graph
    fullest = []
    for seed in range(20):
        labels = metis.cut_graph(graph.weights, graph.all_edges, 4, imbalance=imbalance, seed=seed)
        fullest.append(np.bincount(labels).max())
    assert max(fullest) <= 100 * (1 + imbalance)
    if imbalance == 0.1:  # a wider bound is used: the narrow one would be broken
        assert max(fullest) > 101


def test_all_points_in_one_voxel_are_split_by_the_octree():
    positions, _ = cloud(400, 1)
    found = cut(positions / 1000, torch.ones(400, dtype=torch.int64), 4, imbalance=0.02)
    assert found.balanced
    assert int(found.graph.levels.min()) >= 1
    assert found.loads.sum() == 400


def test_a_voxel_heavier_than_a_block_is_split():
    far, _ = cloud(200, 2)
    dense = torch.rand(600, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    positions = torch.cat([far + torch.tensor([2.0, 0, 0]), dense])
    found = cut(positions, torch.ones(800, dtype=torch.int64), 4, imbalance=0.05)
    assert found.balanced
    assert found.graph.levels.max() >= 1


def test_a_point_heavier_than_a_block_is_reported():
    positions, loads = cloud(100, 3)
    loads = loads.index_fill(0, torch.tensor([7]), 10_000)
    found = cut(positions, loads, 4)
    assert not found.balanced
    # The best there is: the heavy point's block is at least the point, 4 * 10000 / total of the mean.
    least = 4 * 10_000 / float(loads.sum()) - 1
    assert least <= found.worst < least + 0.05


def test_coincident_points_are_never_split_and_are_reported():
    positions = torch.zeros(50, 3, dtype=torch.float64)
    positions[40:, 0] = torch.arange(1, 11)
    found = cut(positions, torch.ones(50, dtype=torch.int64), 2)
    assert not found.balanced
    assert len(found.labels[:40].unique()) == 1
    assert found.loads.tolist() == [40, 10]


def test_points_on_a_line_are_cut_into_runs():
    positions = torch.zeros(400, 3, dtype=torch.float64)
    positions[:, 1] = torch.arange(400) / 4
    found = cut(positions, torch.ones(400, dtype=torch.int64), 4, imbalance=0.05)
    assert found.balanced
    assert found.edge_cut == 3
    assert int((found.labels.diff() != 0).sum()) == 3


def test_points_that_nobody_saw_still_have_owners():
    positions, _ = cloud(80, 4)
    found = cut(positions, torch.zeros(80, dtype=torch.int64), 3)
    assert found.labels.unique().tolist() == [0, 1, 2]
    assert found.worst == 0
    assert found.balanced


@pytest.mark.parametrize("load", [0, 1])
def test_more_blocks_than_voxels_halves_the_voxels(load):
    positions = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]], dtype=torch.float64)
    found = cut(positions, torch.full((3,), load), 3)
    assert found.balanced
    assert sorted(found.labels.tolist()) == [0, 1, 2]


def test_positions_outside_every_voxel_go_to_the_nearest_one():
    positions = torch.tensor([[0.0, 0, 0], [10.0, 0, 0]], dtype=torch.float64)
    found = cut(positions, torch.tensor([1, 1]), 2)
    probes = torch.tensor([[-5.0, 0, 0], [4.0, 0, 0], [7.0, 0, 0], [99.0, 0, 0]]).double()
    assert odbp.owner(found, probes).tolist() == [0, 0, 1, 1]


@settings(max_examples=30)
@given(count=st.integers(1, 60), blocks=st.integers(1, 8), seed=SEEDS)
def test_slabs_differ_from_the_mean_by_at_most_the_heaviest_voxel(count, blocks, seed):
    positions, loads = cloud(count, seed)
    graph = cut(positions, loads + 1, 1).graph
    if blocks > len(graph.weights):
        return
    labels = odbp.slabs(graph, blocks)
    sums = np.bincount(labels, weights=graph.weights, minlength=blocks)
    assert set(labels.tolist()) == set(range(blocks))
    if graph.weights.max() <= sums.mean() / 2:  # so heavy that no slab has to be filled by force
        assert np.abs(sums - sums.mean()).max() <= graph.weights.max()


@pytest.mark.parametrize(
    "wrong",
    [{"blocks": 0}, {"blocks": 2, "imbalance": 0.0}, {"blocks": 2, "seeds": 0}],
)
def test_settings_without_sense_are_refused(wrong):
    positions, loads = cloud(20, 0)
    with pytest.raises(UsageError):
        odbp.partition(positions, loads, OdbpSettings(voxel_size=1.0, **wrong))


def test_negative_loads_are_refused():
    positions, loads = cloud(20, 0)
    with pytest.raises(DataError, match="load of -1"):
        cut(positions, loads - 1 - loads, 2)
