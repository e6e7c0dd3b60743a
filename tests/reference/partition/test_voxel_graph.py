"""Voxel graph of ODBP: loads, neighbours by brute force, bridges by networkx."""

import itertools

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.clouds import cloud
from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition import voxel_graph as vg

CLOUDS = {"count": st.integers(0, 60), "seed": st.integers(0, 2**16), "halved": st.booleans()}


def build(count: int, seed: int, halved: bool) -> vg.VoxelGraph:
    """A graph of a sparse cloud; with `halved`, some voxels are halved once or twice."""
    positions, loads = cloud(count, seed)
    grid = vg.grid_coordinates(positions.numpy(), 1.0)
    levels = np.zeros(count, dtype=np.int64)
    if halved:  # per voxel, not per point: all points of a voxel are halved together
        voxel = np.floor(grid).astype(np.int64)
        levels = np.array([0, 1, 2], dtype=np.int64)[(voxel @ [5, 7, 1]) % 3]
    return vg.voxel_graph(grid, loads.numpy(), levels)


def boxes(graph: vg.VoxelGraph) -> tuple[np.ndarray, np.ndarray]:
    """Integer lower and upper corners of the voxels in quarters of a voxel (levels 0 to 2)."""
    side = 4 >> graph.levels
    low = graph.cells * side[:, None]
    return low, low + side[:, None]


def touching(graph: vg.VoxelGraph) -> set[tuple[int, int]]:
    """Pairs of boxes that share area: they touch along one axis and overlap along the others."""
    low, high = boxes(graph)
    pairs = set()
    for i, j in itertools.combinations(range(len(low)), 2):
        overlap = np.minimum(high[i], high[j]) - np.maximum(low[i], low[j])
        if sorted(overlap > 0) == [False, True, True] and overlap.min() == 0:
            pairs.add((i, j))
    return pairs


@settings(max_examples=40)
@given(**CLOUDS)
def test_edges_are_the_pairs_of_boxes_that_share_area(count, seed, halved):
    graph = build(count, seed, halved)
    assert {tuple(edge) for edge in graph.edges.tolist()} == touching(graph)
    assert (graph.edges[:, 0] < graph.edges[:, 1]).all()


@settings(max_examples=40)
@given(**CLOUDS)
def test_loads_add_up_and_each_point_lies_in_its_voxel(count, seed, halved):
    graph = build(count, seed, halved)
    positions, loads = cloud(count, seed)
    grid = vg.grid_coordinates(positions.numpy(), 1.0)
    assert graph.weights.sum() == int(loads.sum())
    low, high = boxes(graph)
    mine = graph.voxel_of_point
    assert (4 * grid >= low[mine]).all()
    assert (4 * grid < high[mine]).all()
    for voxel in range(len(graph.weights)):
        assert graph.weights[voxel] == loads.numpy()[mine == voxel].sum()


@settings(max_examples=40)
@given(**CLOUDS)
def test_bridges_are_a_minimum_spanning_tree_of_the_components(count, seed, halved):
    graph = build(count, seed, halved)
    nodes = range(len(graph.weights))
    real = networkx.Graph(list(map(tuple, graph.edges.tolist())))
    real.add_nodes_from(nodes)
    parts = list(networkx.connected_components(real))
    centres = np.mean(boxes(graph), axis=0) / 4

    def gap(a: set[int], b: set[int]) -> float:
        return min(float(np.linalg.norm(centres[i] - centres[j])) for i in a for j in b)

    between = networkx.Graph()
    between.add_weighted_edges_from(
        (i, j, gap(parts[i], parts[j])) for i, j in itertools.combinations(range(len(parts)), 2)
    )
    want = networkx.minimum_spanning_tree(between).size(weight="weight")
    lengths = np.linalg.norm(centres[graph.bridges[:, 0]] - centres[graph.bridges[:, 1]], axis=1)
    assert len(graph.bridges) == max(0, len(parts) - 1)
    assert lengths.sum() == pytest.approx(want)
    real.add_edges_from(map(tuple, graph.bridges.tolist()))
    assert len(graph.weights) == 0 or networkx.is_connected(real)


@settings(max_examples=30)
@given(count=st.integers(1, 60), seed=st.integers(0, 2**16))
def test_the_graph_does_not_depend_on_the_order_of_the_points(count, seed):
    positions, loads = cloud(count, seed)
    grid, loads = vg.grid_coordinates(positions.numpy(), 1.0), loads.numpy()
    order = np.random.default_rng(seed).permutation(count)
    levels = np.zeros(count, dtype=np.int64)
    a, b = (vg.voxel_graph(grid[i], loads[i], levels) for i in (np.arange(count), order))
    assert (a.cells == b.cells).all()
    assert (a.weights == b.weights).all()
    assert (a.all_edges == b.all_edges).all()
    assert (a.voxel_of_point[order] == b.voxel_of_point).all()


def test_two_islands_by_hand():
    # Voxels of side 2: an L of three at (0,0), (1,0), (1,1); an island of one at (4,0).
    points = np.array([[3.0, 1, 0], [5.5, 1, 0], [6.9, 1, 0], [5.5, 3, 0], [11.5, 0, 0]])
    grid = vg.grid_coordinates(points, 2.0)  # from (3, 0, 0): x becomes 0, 1.25, 1.95, 1.25, 4.25
    graph = vg.voxel_graph(grid, np.array([3, 4, 5, 2, 7]), np.zeros(5, dtype=np.int64))
    assert graph.cells.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [4, 0, 0]]
    assert graph.weights.tolist() == [3, 9, 2, 7]
    assert graph.edges.tolist() == [[0, 1], [1, 2]]
    assert graph.bridges.tolist() == [[1, 3]]  # 3 apart; (1,1) to (4,0) is sqrt(10)


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_voxel_size_that_is_no_length_is_refused(size):
    with pytest.raises(UsageError, match="voxel size"):
        vg.grid_coordinates(np.zeros((2, 3)), size)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_points_that_are_not_finite_are_refused(bad):
    with pytest.raises(DataError, match="1 of 2 points"):
        vg.grid_coordinates(np.array([[0.0, 0, 0], [bad, 0, 0]]), 1.0)


def test_a_scene_too_wide_for_its_voxels_is_refused():
    with pytest.raises(DataError, match="voxels"):
        vg.grid_coordinates(np.array([[0.0, 0, 0], [2.0**40, 0, 0]]), 1.0)
