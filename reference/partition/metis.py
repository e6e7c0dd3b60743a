"""Balanced k-way cuts of a vertex-weighted graph by METIS (through pymetis)."""

import numpy as np
import pymetis
from jaxtyping import Int64


def cut_graph(
    weights: Int64[np.ndarray, " v"],
    edges: Int64[np.ndarray, "e 2"],
    parts: int,
    *,
    imbalance: float,
    seed: int,
    contiguous: bool = True,
) -> Int64[np.ndarray, " v"]:
    """Parts that minimise the cut edges with every load <= (1 + imbalance) of the mean.

    METIS bounds loads from above only, and on small graphs may leave a part empty or break the
    bound: the caller looks. The weights are divided by their greatest common divisor first, so that
    their unit changes nothing.

    Args:
        weights: Vertex weights >= 0, not all 0.
        edges: Pairs of vertices of a connected graph, each once.
        parts: Number of parts, 1 to the number of vertices.
        imbalance: epsilon > 0, in steps of 0.001 (METIS' own unit).
        seed: Seed of METIS' generator.
        contiguous: Ask for connected parts; in graphs of many slender pieces METIS then often fails
            to balance them.

    Returns: Part of each vertex, in [0, parts).

    Source: Karypis and Kumar 1998, "Multilevel k-way Partitioning Scheme for Irregular Graphs".
    """
    count = len(weights)
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    starts = np.searchsorted(both[:, 0], np.arange(count + 1))
    options = pymetis.Options()
    options.contig = int(contiguous)
    options.seed = seed
    options.ufactor = max(1, round(1000 * imbalance))
    graph = pymetis.CSRAdjacency(starts.tolist(), both[:, 1].tolist())
    unit = int(np.gcd.reduce(weights))
    found = pymetis.part_graph(
        parts, graph, vweights=(weights // unit).tolist(), recursive=False, options=options
    )
    return np.array(found.vertex_part, dtype=np.int64)


def cut_size(edges: Int64[np.ndarray, "e 2"], labels: Int64[np.ndarray, " v"]) -> int:
    """Number of edges whose ends lie in different parts (DPGS, Eq. 6).

    Args:
        edges: Pairs of vertices, each edge once.
        labels: Part of each vertex.
    """
    return int((labels[edges[:, 0]] != labels[edges[:, 1]]).sum())
