"""Observation density balanced partitioning: blocks of equal rendering load, cut where it is thin."""

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition.metis import cut_graph, cut_size
from splatproof.reference.partition.voxel_graph import (
    DEEPEST,
    VoxelGraph,
    components,
    grid_coordinates,
    voxel_centres,
    voxel_graph,
)

FINER = 2
"""Between two attempts the heaviest voxel shrinks at least by this factor."""


@dataclass(frozen=True, kw_only=True)
class OdbpSettings:
    """How a scene is cut into blocks of equal rendering load."""

    blocks: int
    """K, the number of blocks, at least 1."""
    voxel_size: float
    """Side of a voxel in scene units."""
    imbalance: float = 0.05
    """epsilon: every block's load is to be within (1 +- epsilon) of the mean (DPGS, Eq. 6)."""
    seeds: int = 10
    """Number of METIS seeds an attempt, each with and without asking for connected blocks; the best
    result stays."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OdbpPartition:
    """Who owns what. Blocks are numbered by their first voxel; every point has exactly one owner."""

    graph: VoxelGraph
    voxel_size: float
    origin: Float64[np.ndarray, "3"]
    """Lowest corner of the grid, in scene units."""
    voxel_labels: Int64[np.ndarray, " v"]
    """Block of each voxel."""
    labels: Int64[Tensor, " n"]
    """Block of each point."""
    loads: Int64[Tensor, " k"]
    """Summed track length of each block's points."""
    edge_cut: int
    """Number of edges and bridges of the graph that join different blocks."""
    worst: float
    """Largest |load / mean - 1| over the blocks; 0 where all loads are 0."""
    balanced: bool
    """worst <= epsilon. False says that no attempt was: the best one found is what is here."""
    contiguous: bool
    """Every block is connected through faces and bridges."""


def partition(
    positions: Float64[Tensor, "n 3"], loads: Int64[Tensor, " n"], settings: OdbpSettings
) -> OdbpPartition:
    """Cut a scene into K blocks of equal load: min cut s.t. |load_k / mean - 1| <= epsilon.

    Voxels heavier than (1 + epsilon) of the mean block load make that impossible, so they are
    halved (octree) first. METIS is run with several seeds and the smallest cut whose loads all lie
    within the bound, above and below, is kept. When none does, the voxels over half the
    heaviest one are halved and METIS is asked again, until none that can be halved is heavier than
    epsilon of the mean; slabs, the last resort, are then within the bound unless points are
    heavier than that. Where all loads are 0 every voxel counts as 1.

    Args:
        positions: Points in the scene's frame (z up makes voxels stand upright).
        loads: l(p) >= 0: track lengths (visibility.track_lengths).
        settings: K, voxel size, epsilon, number of METIS seeds.

    Returns: Labels, loads and cut; `balanced` tells whether the bound holds.

    Raises: UsageError for K < 1 or a voxel size <= 0; DataError for more blocks than distinct
        positions, for non-finite positions or negative loads.

    Source: DPGS, Sec. 3.3, Eqs. 5, 6; splitting, seeds and the two-sided choice: ours.
    """
    if settings.blocks < 1 or settings.imbalance <= 0 or settings.seeds < 1:
        raise UsageError(f"{settings}: expected blocks >= 1, imbalance > 0, seeds >= 1")
    if bool((loads < 0).any()):
        raise DataError(f"a load of {int(loads.min())}: expected track lengths >= 0")
    points, weights = positions.numpy(), loads.numpy()
    grid = grid_coordinates(points, settings.voxel_size)
    distinct = len(np.unique(np.floor(grid * 2.0**DEEPEST), axis=0))
    if settings.blocks > max(distinct, 1):
        raise DataError(f"{settings.blocks} blocks for {distinct} distinct points: ask for fewer")

    levels = np.zeros(len(points), dtype=np.int64)
    mean = weights.sum() / settings.blocks
    limit, best = (1 + settings.imbalance) * mean, None
    while True:
        graph, levels, halvable = halve(grid, weights, levels, limit, at_least=settings.blocks)
        found = _summary(graph, smallest_cut(graph, settings), points, settings)
        best = found if best is None or _rank(found) < _rank(best) else best
        heaviest = graph.weights[halvable].max(initial=0)
        if best.balanced or heaviest <= settings.imbalance * mean:
            break
        limit = heaviest / FINER
    last = _summary(graph, slabs(graph, settings.blocks), points, settings)
    return last if not best.balanced and _rank(last) < _rank(best) else best


def halve(
    grid: Float64[np.ndarray, "n 3"],
    loads: Int64[np.ndarray, " n"],
    levels: Int64[np.ndarray, " n"],
    limit: float,
    *,
    at_least: int,
) -> tuple[VoxelGraph, Int64[np.ndarray, " n"], Bool[np.ndarray, " v"]]:
    """Halve voxels (octree) until none that can be is heavier than `limit`, or too few are there.

    A voxel with one point, or with points that coincide, stays as heavy as it is.

    Args:
        grid: Positions in voxels, >= 0 (grid_coordinates).
        loads: Load of each point.
        levels: How often the voxel around each point has been halved so far.
        limit: Heaviest voxel allowed.
        at_least: While there are fewer voxels than this, all that can be halved are.

    Returns: The graph, the new levels, and which voxels could be halved further.
    """
    while True:
        graph = voxel_graph(grid, loads, levels)
        voxel, count = graph.voxel_of_point, len(graph.weights)
        one = np.zeros((count, 3))
        one[voxel] = grid  # any one point of each voxel
        spread = np.zeros(count, dtype=bool)
        np.logical_or.at(spread, voxel, (grid != one[voxel]).any(axis=1))
        halvable = spread & (graph.levels < DEEPEST)
        chosen = halvable & ((graph.weights > limit) | (count < at_least))
        if not chosen.any():
            return graph, levels, halvable
        levels = levels + chosen[voxel]


def smallest_cut(graph: VoxelGraph, settings: OdbpSettings) -> Int64[np.ndarray, " v"]:
    """Labels of the best METIS run: within the bound, then connected blocks, then the smallest cut.

    Half of the runs ask for connected blocks. Runs that leave a block empty do not count (METIS
    does that below about four voxels a block); slabs stand in where no run is left.

    Args:
        graph: The voxels with their loads; its edges and bridges connect it.
        settings: K, epsilon and the number of METIS seeds.
    """
    weights, count = graph.weights, settings.blocks
    if count == 1 or len(weights) < 2 * count:
        return slabs(graph, count)
    weights = weights if weights.any() else np.ones_like(weights)
    candidates = []
    for contiguous, seed in itertools.product((True, False), range(settings.seeds)):
        labels = cut_graph(
            weights, graph.all_edges, count,
            imbalance=settings.imbalance, seed=seed, contiguous=contiguous,
        )  # fmt: skip
        over = max(worst_deviation(labels, weights, count), settings.imbalance)
        pieces = connected_pieces(graph, labels)
        if len(np.unique(labels)) == count:
            rank = (over, pieces > count, cut_size(graph.all_edges, labels))
            candidates.append((*rank, len(candidates), labels))
    return min(candidates, key=lambda row: row[:4])[4] if candidates else slabs(graph, count)


def connected_pieces(graph: VoxelGraph, labels: Int64[np.ndarray, " v"]) -> int:
    """Number of pieces the blocks consist of, joined by faces and bridges: K if all are connected.

    Args:
        graph: The voxels, joined by its edges and bridges.
        labels: Block of each voxel.
    """
    kept = graph.all_edges[labels[graph.all_edges[:, 0]] == labels[graph.all_edges[:, 1]]]
    return int(components(len(labels), kept).max(initial=-1)) + 1


def slabs(graph: VoxelGraph, count: int) -> Int64[np.ndarray, " v"]:
    """Cut the voxels, sorted along their longest axis, where the summed load passes i/K of it all.

    Each cut lies within half a voxel's load of its target, so that loads differ from the mean by at
    most the heaviest voxel. No slab is empty while there are K voxels.

    Args:
        graph: The voxels with their loads; where all loads are 0 every voxel counts as 1.
        count: Number of slabs K, at least 1.

    Returns: Slab of each voxel, in [0, K).

    Source: ours.
    """
    centres = voxel_centres(graph.levels, graph.cells)
    if count == 1 or len(centres) == 0:
        return np.zeros(len(centres), dtype=np.int64)
    axis = np.ptp(centres, axis=0).argmax()
    order = np.lexsort((centres[:, (axis + 2) % 3], centres[:, (axis + 1) % 3], centres[:, axis]))
    weights = graph.weights[order] if graph.weights.any() else np.ones(len(order))
    passed = np.concatenate([[0], weights.cumsum()])
    step = np.arange(1, count)
    cuts = np.abs(passed - step[:, None] * passed[-1] / count).argmin(axis=1)
    cuts = np.minimum(np.maximum.accumulate(cuts - step) + step, len(order) - count + step)
    labels = np.empty(len(order), dtype=np.int64)
    labels[order] = np.searchsorted(np.maximum(cuts, step), np.arange(len(order)), side="right")
    return labels


def worst_deviation(
    labels: Int64[np.ndarray, " v"], weights: Int64[np.ndarray, " v"], count: int
) -> float:
    """Largest |load / mean - 1| over the blocks; 0 where all loads are 0.

    Args:
        labels: Block of each voxel, in [0, count).
        weights: Load of each voxel, >= 0.
        count: Number of blocks; one without voxels counts with load 0.
    """
    loads = np.bincount(labels, weights=weights, minlength=count)
    return float(np.abs(loads / loads.mean() - 1).max()) if loads.any() else 0.0


def owner(partition: OdbpPartition, positions: Float64[Tensor, "m 3"]) -> Int64[Tensor, " m"]:
    """Block that owns each position: that of the voxel around it, else of the nearest voxel centre.

    The merge rule: after training, block k keeps the Gaussians whose means it owns, so that the
    merged model holds each place exactly once, wherever its Gaussians moved.

    Args:
        partition: The blocks and their voxels.
        positions: Positions in the frame and unit of the points that were cut.

    Source: DPGS, Sec. 3.3 (rigid blocks); positions outside every voxel: ours.
    """
    graph = partition.graph
    if len(graph.weights) == 0:
        return torch.zeros(len(positions), dtype=torch.int64)
    grid = (positions.numpy() - partition.origin) / partition.voxel_size
    voxel = np.asarray(KDTree(voxel_centres(graph.levels, graph.cells)).query(grid)[1], np.int64)
    for level in np.unique(graph.levels):
        here = np.where(graph.levels == level)[0]
        index = {tuple(cell): i for i, cell in zip(here, graph.cells[here].tolist(), strict=True)}
        cells = map(tuple, np.floor(grid * 2.0**level).astype(np.int64).tolist())
        voxel = np.array([index.get(c, v) for c, v in zip(cells, voxel, strict=True)], np.int64)
    return torch.from_numpy(partition.voxel_labels[voxel])


def _rank(found: OdbpPartition) -> tuple[float, int]:
    """Smaller is better: first how far the loads are out of bounds, then the cut."""
    return (0.0 if found.balanced else found.worst, found.edge_cut)


def _summary(
    graph: VoxelGraph,
    labels: Int64[np.ndarray, " v"],
    points: Float64[np.ndarray, "n 3"],
    settings: OdbpSettings,
) -> OdbpPartition:
    """Loads, cut and balance of labelled voxels, blocks renumbered by their first voxel."""
    first = np.full(settings.blocks, len(labels))
    np.minimum.at(first, labels, np.arange(len(labels)))
    labels = first.argsort(kind="stable").argsort()[labels]
    loads = np.zeros(settings.blocks, dtype=np.int64)
    np.add.at(loads, labels, graph.weights)
    worst = worst_deviation(labels, graph.weights, settings.blocks)
    return OdbpPartition(
        graph=graph,
        voxel_size=settings.voxel_size,
        origin=points.min(axis=0) if len(points) else np.zeros(3),
        voxel_labels=labels,
        labels=torch.from_numpy(labels[graph.voxel_of_point]),
        loads=torch.from_numpy(loads),
        edge_cut=cut_size(graph.all_edges, labels),
        worst=worst,
        balanced=worst <= settings.imbalance,
        contiguous=connected_pieces(graph, labels) <= settings.blocks,
    )
