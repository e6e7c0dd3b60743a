"""Which photos are matched with which.

All with all where they are few; else the nearest by GPS, or the next by name and the most alike.
"""

import warnings
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float32, Float64
from scipy.cluster.vq import kmeans2, vq
from scipy.spatial import KDTree

EXHAUSTIVE = 40
"""Up to this many photos every pair is matched."""
NEIGHBOURS = 30
"""Nearest photos by GPS: with 80 % forward and 60 % side overlap about 25 photos overlap."""
FOLLOWING = 5
"""Each photo is also matched with this many next ones by name."""
ALIKE = 20
"""Most alike photos that a photo without GPS is matched with."""
GPS_SHARE = 0.8
"""GPS is used where at least this share of the photos has it."""
_WORDS = 32
_SAMPLE = 50_000

Pairs = set[tuple[int, int]]


def exhaustive(count: int) -> Pairs:
    """Every pair."""
    return {(a, b) for a in range(count) for b in range(a + 1, count)}


def following(count: int) -> Pairs:
    """Each photo with the next ones by name."""
    return {(a, b) for a in range(count) for b in range(a + 1, min(a + 1 + FOLLOWING, count))}


def nearest(positions: Float64[np.ndarray, "n d"], of: Sequence[int]) -> Pairs:
    """Each photo with its nearest ones on the map.

    Args:
        positions: Place of each photo that has one, e.g. east and north in metres.
        of: Index of the photo that each position belongs to.
    """
    count = min(NEIGHBOURS + 1, len(of))
    near = np.asarray(KDTree(positions).query(positions, k=count)[1]).reshape(len(of), count)
    return _unordered((of[a], of[b]) for a, row in enumerate(near) for b in row)


def alike(signatures: Float32[np.ndarray, "n d"], wanting: Sequence[int]) -> Pairs:
    """Each wanting photo with those whose signatures have the largest dot product.

    Args:
        signatures: Signature of every photo, of length 1 or all zeros (see `vlad`).
        wanting: Indices of the photos that get partners.
    """
    likeness = signatures[list(wanting)] @ signatures.T
    best = np.argsort(-likeness, axis=1, kind="stable")[:, : ALIKE + 1]
    return _unordered((a, int(b)) for a, row in zip(wanting, best, strict=True) for b in row)


def vlad(descriptors: Sequence[np.ndarray], seed: int) -> Float32[np.ndarray, "n d"]:
    """VLAD signatures: per visual word the sum of residuals, square-rooted, of length 1.

    Args:
        descriptors: SIFT descriptors of each photo, n x 128, uint8; may be empty.
        seed: Decides which descriptors are sampled and where k-means starts.

    Source: Jegou et al. 2010, "Aggregating local descriptors into a compact image
        representation", Sec. 3; power normalisation as in their later work.
    """
    rng = np.random.default_rng(seed)
    every = np.concatenate([each.reshape(-1, 128) for each in descriptors]).astype(np.float32)
    sample = every[rng.permutation(len(every))[:_SAMPLE]]
    words = min(_WORDS, len(sample) // 10)
    table = np.zeros((len(descriptors), max(words, 1), 128), dtype=np.float32)
    if words:
        with warnings.catch_warnings(action="ignore"):  # a word may lose all its members
            centres, _ = kmeans2(sample, words, minit="points", rng=rng)
        for row, each in zip(table, descriptors, strict=True):
            if len(each):
                own = each.astype(np.float32)
                word, _ = vq(own, centres)
                np.add.at(row, word, own - centres[word])
    flat = table.reshape(len(descriptors), -1)
    flat = np.sign(flat) * np.sqrt(np.abs(flat))
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)


def _unordered(pairs: Iterable[tuple[int, int]]) -> Pairs:
    return {(min(a, b), max(a, b)) for a, b in pairs if a != b}
