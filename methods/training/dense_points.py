"""Points where structure from motion has none: training photos matched by flow, triangulated, merged."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.datasets.image_cache import ImageCache
from splatproof.datasets.progress import bar
from splatproof.reference.supervision.dense_initialisation import (
    DensePoints,
    DenseSettings,
    points_of_pair,
    select_pairs,
)
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints, View

LEAST_MATCHES = 4
"""A voxel with fewer holds nothing but stray matches."""
APART = 0.7
"""Cells between a new point and the nearest sparse one, at least: the sparse ones are better."""


def with_dense_points(scene: Scene, cell: float, image_bytes: int) -> Scene:
    """The scene with points added between its own, about one every `cell` pixels of its photos.

    Pairs, matches, triangulation and scores are DPGS's; in each voxel their mean weighted by score.
    Only training views are matched, and only their tracks choose pairs. The same scene gives the
    same points. Memory grows with the voxels, not with the pairs.

    Args:
        scene: With sparse points and tracks; one without is returned as it is.
        cell: Edge of a voxel in pixels of the training images at the median depth of the sparse
            points, > 0.
        image_bytes: Most bytes of images kept while pairs are matched.

    Source: DPGS, Sec. 3.1, and its spec, step 5; voxel size and least number of matches: ours.
    """
    seen = observed(scene)[list(scene.train)]
    if not seen.any():
        return scene
    views = scene.train_views
    centres = torch.stack([view.camera.centre for view in views])
    settings = DenseSettings()
    pairs = select_pairs(centres, scene.points.positions, seen, settings)
    edge = cell * footprint(views, scene.points.positions, seen)
    images, voxels = ImageCache(image_bytes), Voxels(edge)
    with bar(f"matching {len(pairs)} pairs of photos") as report:
        for done, (a, b) in enumerate(pairs):
            shared = scene.points.positions[seen[a] & seen[b]]
            found = match(views[a], views[b], shared, images, settings)
            voxels.add(found, (scene.train[a], scene.train[b]))
            report(done + 1, len(pairs))
    return extended(scene, voxels.points(), APART * edge)


def observed(scene: Scene) -> Bool[Tensor, "v n"]:
    """Which view's track holds which point."""
    seen = torch.zeros(len(scene.views), len(scene.points), dtype=torch.bool)
    point = torch.repeat_interleave(
        torch.arange(len(scene.points)), scene.points.track_starts.diff()
    )
    seen[scene.points.track_views, point] = True
    return seen


def footprint(
    views: tuple[View, ...], positions: Float[Tensor, "n 3"], seen: Bool[Tensor, "v n"]
) -> float:
    """Median size of a pixel on what the views see, in scene units: z / f over all observations."""
    sizes = [
        project_points(view.camera, positions[mask])[1] / view.camera.K[0, 0]
        for view, mask in zip(views, seen, strict=True)
    ]
    return float(torch.cat(sizes).median())


def match(
    first: View,
    second: View,
    shared: Float[Tensor, "n 3"],
    images: ImageCache,
    settings: DenseSettings,
) -> DensePoints:
    """Points of two views; masked pixels of the first give none.

    Args:
        first: The view whose pixels are followed.
        second: The view they are found in.
        shared: Sparse points that both see, for the plane that brings the photos together.
        images: Of the views.
        settings: Thresholds.
    """
    image = images.load(first)
    plane = plane_between(
        project_points(first.camera, shared)[0], project_points(second.camera, shared)[0]
    )
    other = images.load(second)
    if plane is None and image.shape != other.shape:
        nothing = shared.new_zeros(0, 3)
        return DensePoints(positions=nothing, colours=nothing, scores=nothing[:, 0])
    warp, certainty = match_by_flow(image, other, plane)
    if first.load_mask is not None:
        certainty = certainty * first.load_mask()
    return points_of_pair(first.camera, second.camera, image, warp.double(), certainty, settings)


class Voxels:
    """A cloud that grows pair by pair and keeps sums of each voxel only."""

    def __init__(self, edge: float) -> None:
        """Start empty. `edge` in scene units."""
        self.edge = edge
        self._keys = np.zeros((0, 3), np.int64)
        self._sums = np.zeros((0, 8))
        self._tracks = np.zeros((0, 4), np.int64)

    def add(self, found: DensePoints, views: tuple[int, int]) -> None:
        """Take the points of one pair in.

        Args:
            found: Any number of points.
            views: Indices of the two views.
        """
        positions, weights = found.positions.numpy(), found.scores.numpy()[:, None]
        ones = np.ones_like(weights)
        rows = [weights * positions, weights * found.colours.numpy(), weights, ones]
        keys, sums = summed(np.floor(positions / self.edge).astype(np.int64), np.hstack(rows))
        for view in views:
            track = np.hstack([keys, np.full((len(keys), 1), view)])
            self._tracks = np.unique(np.concatenate([self._tracks, track]), axis=0)
        self._keys, self._sums = summed(
            np.concatenate([self._keys, keys]), np.concatenate([self._sums, sums])
        )

    def points(self) -> SparsePoints:
        """One point a voxel with enough matches, in the order of the voxels."""
        kept = self._sums[:, 7] >= LEAST_MATCHES
        means = self._sums[kept, :6] / self._sums[kept, 6:7]
        # voxels and tracks are sorted by the same key, so the rows of kept voxels are in order
        owner = np.searchsorted(ordered(self._keys), ordered(self._tracks[:, :3]))
        rows = kept[owner]
        starts = np.concatenate([[0], np.bincount(owner, minlength=len(kept))[kept].cumsum()])
        return SparsePoints(
            positions=torch.from_numpy(means[:, :3]),
            colours=torch.from_numpy((means[:, 3:] * 255).round().clip(0, 255).astype(np.uint8)),
            track_starts=torch.from_numpy(starts),
            track_views=torch.from_numpy(self._tracks[rows, 3]),
        )


def summed(
    keys: Int64[np.ndarray, "n 3"], rows: Float64[np.ndarray, "n c"]
) -> tuple[Int64[np.ndarray, "m 3"], Float64[np.ndarray, "m c"]]:
    """Sorted distinct keys and the sum of the rows of each."""
    distinct, owner = np.unique(keys, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    columns = [np.bincount(owner, column, len(distinct)) for column in rows.T]
    return distinct, np.stack(columns, axis=1)


def ordered(keys: Int64[np.ndarray, "n 3"]) -> np.ndarray:
    """Keys as single values that sort as the rows do."""
    return np.ascontiguousarray(keys).view([("x", "i8"), ("y", "i8"), ("z", "i8")])[:, 0]


def extended(scene: Scene, found: SparsePoints, apart: float) -> Scene:
    """The scene with those points that are at least `apart` from each of its own."""
    own = scene.points
    tree = KDTree(own.positions.double().numpy())
    lengths = found.track_starts.diff()
    far = torch.from_numpy(tree.query(found.positions.numpy())[0] >= apart)
    starts = own.track_starts[-1] + lengths[far].cumsum(0)
    return replace(
        scene,
        points=SparsePoints(
            positions=torch.cat([own.positions, found.positions[far].to(own.positions)]),
            colours=torch.cat([own.colours, found.colours[far]]),
            track_starts=torch.cat([own.track_starts, starts.to(own.track_starts)]),
            track_views=torch.cat(
                [own.track_views, found.track_views[torch.repeat_interleave(far, lengths)]]
            ),
        ),
    )
