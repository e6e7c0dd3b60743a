"""The weighted graph that ODBP cuts: occupied voxels, their loads, 6-neighbours and bridges."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from splatproof.base.errors import DataError, UsageError

DEEPEST = 20
"""A voxel is halved at most this often; points that then still share one count as coincident."""
WIDEST = 2**30
"""Most voxels along an axis; with DEEPEST halvings the cells still fit an int64 and a float64."""


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelGraph:
    """Occupied voxels of a point cloud as an undirected, connected, vertex-weighted graph.

    Voxels are sorted by (level, cell), so the graph does not depend on the order of the points.
    """

    voxel_of_point: Int64[np.ndarray, " n"]
    """Index of the voxel that holds each point."""
    levels: Int64[np.ndarray, " v"]
    """How often the voxel was halved: its side is voxel_size / 2^level."""
    cells: Int64[np.ndarray, "v 3"]
    """Integer position of the voxel in the grid of its own level."""
    weights: Int64[np.ndarray, " v"]
    """Load w_j of each voxel: the track lengths of its points, summed."""
    edges: Int64[np.ndarray, "e 2"]
    """Pairs (low, high) of voxels that share a face."""
    bridges: Int64[np.ndarray, "b 2"]
    """Pairs (low, high) that join components which share no face: one fewer than components."""

    @property
    def all_edges(self) -> Int64[np.ndarray, "m 2"]:
        """Edges and bridges: what a cut is counted over."""
        return np.concatenate([self.edges, self.bridges])


def grid_coordinates(
    positions: Float64[np.ndarray, "n 3"], voxel_size: float
) -> Float64[np.ndarray, "n 3"]:
    """Positions in voxels from the lowest corner of their bounds: x = (p - min p) / size.

    The grid hangs on the points, so moving or scaling scene and voxel together changes nothing.

    Args:
        positions: Points in the scene's frame, scene units.
        voxel_size: Side of an unhalved voxel in scene units, > 0.

    Raises: DataError for positions that are not finite or span more than 2^30 voxels;
        UsageError for a voxel size that is not positive.
    """
    if not (np.isfinite(voxel_size) and voxel_size > 0):
        raise UsageError(f"voxel size {voxel_size}: expected a positive length in scene units")
    if not np.isfinite(positions).all():
        bad = int((~np.isfinite(positions).all(axis=1)).sum())
        raise DataError(f"{bad} of {len(positions)} points are not finite; drop them first")
    if len(positions) == 0:
        return positions
    grid = (positions - positions.min(axis=0)) / voxel_size
    if grid.max() >= WIDEST:
        raise DataError(
            f"points span {grid.max():.3g} voxels of {voxel_size}; expected under {WIDEST}: "
            "drop far outliers or choose larger voxels"
        )
    return grid


def voxel_graph(
    grid: Float64[np.ndarray, "n 3"],
    loads: Int64[np.ndarray, " n"],
    point_levels: Int64[np.ndarray, " n"],
) -> VoxelGraph:
    """Graph of the occupied voxels with w_j = sum of the loads of the points in voxel j.

    Args:
        grid: Positions in voxels, >= 0 (grid_coordinates).
        loads: Load l(p) of each point, >= 0: its track length.
        point_levels: How often the voxel around each point was halved; 0 for a plain grid.

    Source: DPGS, Sec. 3.3, Eq. 5. Bridges between components: ours (spec: ODBP, item 2).
    """
    cells = np.floor(grid * 2.0 ** point_levels[:, None]).astype(np.int64)
    keys, voxel_of_point = np.unique(
        np.column_stack([point_levels, cells]), axis=0, return_inverse=True
    )
    voxel_of_point = voxel_of_point.reshape(-1).astype(np.int64)
    weights = np.zeros(len(keys), dtype=np.int64)
    np.add.at(weights, voxel_of_point, loads)
    levels, cells = keys[:, 0], keys[:, 1:]
    edges = face_neighbours(levels, cells)
    return VoxelGraph(
        voxel_of_point=voxel_of_point, levels=levels, cells=cells, weights=weights, edges=edges,
        bridges=bridges(voxel_centres(levels, cells), edges),
    )  # fmt: skip


def voxel_centres(
    levels: Int64[np.ndarray, " v"], cells: Int64[np.ndarray, "v 3"]
) -> Float64[np.ndarray, "v 3"]:
    """Centres of the voxels in units of an unhalved voxel: (cell + 1/2) / 2^level.

    Args:
        levels: How often each voxel was halved.
        cells: Integer position of each voxel in the grid of its own level.
    """
    return (cells + 0.5) / 2.0 ** levels[:, None]


def face_neighbours(
    levels: Int64[np.ndarray, " v"], cells: Int64[np.ndarray, "v 3"]
) -> Int64[np.ndarray, "e 2"]:
    """Pairs of voxels that share (part of) a face, each pair once, low index first, sorted.

    Each voxel looks across its six faces for a voxel of its own size or larger; the larger one of
    two neighbours is thus found from the smaller one's side.

    Args:
        levels: How often each voxel was halved; no voxel lies inside another.
        cells: Integer position of each voxel in the grid of its own level.

    Source: DPGS, Sec. 3.3 (6-connected graph); voxels of mixed size: ours.
    """
    index = {
        (level, tuple(cell)): i
        for i, (level, cell) in enumerate(zip(levels.tolist(), cells.tolist(), strict=True))
    }
    present = sorted(set(levels.tolist()))
    pairs = set()
    for (level, (x, y, z)), i in index.items():
        for dx, dy, dz in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            for coarser in present:
                shift = level - coarser
                if shift < 0:
                    break
                cell = ((x + dx) >> shift, (y + dy) >> shift, (z + dz) >> shift)
                j = index.get((coarser, cell), i)
                if j != i:
                    pairs.add((min(i, j), max(i, j)))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def components(count: int, edges: Int64[np.ndarray, "e 2"]) -> Int64[np.ndarray, " v"]:
    """Component number of each of `count` vertices.

    Args:
        count: Number of vertices.
        edges: Pairs of vertices.

    Returns: Numbers from 0 on, equal for vertices that edges connect.
    """
    ones = np.ones(len(edges), dtype=np.int8)
    matrix = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
    return connected_components(matrix, directed=False)[1].astype(np.int64)


def bridges(
    centres: Float64[np.ndarray, "v 3"], edges: Int64[np.ndarray, "e 2"]
) -> Int64[np.ndarray, "b 2"]:
    """Fewest, shortest extra edges that connect the graph: a minimum spanning tree of components.

    The length between two components is that of their nearest voxel pair (centre to centre).
    Boruvka's algorithm: in each round every component but the largest takes its shortest way out.

    Args:
        centres: Centres of the voxels (voxel_centres).
        edges: Pairs of voxels that are already connected.

    Returns: Pairs (low, high), sorted; none for a connected or empty graph.

    Source: ours (spec: ODBP, item 2).
    """
    found = np.zeros((0, 2), dtype=np.int64)
    while True:
        component = components(len(centres), np.concatenate([edges, found]))
        if component.max(initial=0) == 0:
            return found[np.lexsort((found[:, 1], found[:, 0]))]
        inside, outside, length = ways_out(centres, component)
        order = np.lexsort((outside, inside, length))
        _, first = np.unique(component[inside[order]], return_index=True)
        chosen = np.sort(np.stack([inside, outside], axis=1)[order[np.sort(first)]], axis=1)
        # Where two ways join the same components, or ways form a ring (ties), later ones are left.
        joined = np.arange(component.max() + 1)
        for low, high in chosen.tolist():
            a, b = joined[component[low]], joined[component[high]]
            if a != b:
                joined[joined == a] = b
                found = np.concatenate([found, [[low, high]]])


def ways_out(
    centres: Float64[np.ndarray, "v 3"], component: Int64[np.ndarray, " v"]
) -> tuple[Int64[np.ndarray, " w"], Int64[np.ndarray, " w"], Float64[np.ndarray, " w"]]:
    """Voxel pairs out of each component but the largest, its shortest one among them, and lengths.

    Looks at 2, 4, 8, ... nearest neighbours; a voxel is done when one of them lies in another
    component, or when its component has a way out that is shorter than all of them.

    Args:
        centres: Centres of the voxels (voxel_centres).
        component: Component number of each voxel (components); at least two differ.

    Returns: Voxel inside, voxel outside and the distance between their centres, for each pair.
    """
    tree = KDTree(centres)
    best = np.full(component.max() + 1, np.inf)
    open_ = np.where(component != np.bincount(component).argmax())[0]
    pairs, count = [], 1
    while len(open_):
        count = min(2 * count, len(centres))
        length, near = map(np.asarray, tree.query(centres[open_], k=count))
        foreign = component[near] != component[open_, None]
        out, rank = foreign.any(axis=1), foreign.argmax(axis=1)
        rows = np.where(out)[0]
        pairs.append((open_[rows], near[rows, rank[rows]], length[rows, rank[rows]]))
        np.minimum.at(best, component[open_[rows]], pairs[-1][2])
        open_ = open_[~out & (length[:, -1] < best[component[open_]])]
    inside, outside, lengths = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return inside.astype(np.int64), outside.astype(np.int64), lengths
