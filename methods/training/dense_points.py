"""Points where structure from motion has none: training photos matched by flow, triangulated, merged."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.datasets.image_cache import ImageCache
from splatproof.datasets.progress import bar
from splatproof.reference.supervision.dense_initialisation import (
    DensePoints,
    DenseSettings,
    observations,
    points_of,
    points_of_pair,
    seen_by_both,
    select_pairs,
)
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints, View

LEAST_MATCHES = 4
"""Number of matches that a voxel needs; with fewer it holds nothing but stray ones."""
APART = 0.7
"""Cells between a new point and the nearest sparse one, at least: the sparse ones are better."""


def with_dense_points(
    scene: Scene, cell: float, image_bytes: int, settings: DenseSettings
) -> Scene:
    """The scene with points added between its own, about one every `cell` pixels of its photos.

    Pairs, matches, triangulation and scores are DPGS's; in each voxel their mean weighted by score.
    Only training views are matched, and only their tracks choose pairs. The same scene gives the
    same points, and a scene that was moved the same points moved. Memory grows with observations
    and voxels, neither with views x points nor with the pairs.

    Args:
        scene: A scene with sparse points and tracks; one without tracks is returned as it is.
        cell: Edge of a voxel in pixels of the training images at the median depth of the sparse
            points, > 0.
        image_bytes: Most bytes of images kept while pairs are matched.
        settings: Which images form pairs, and which matches become points.

    Source: DPGS, Sec. 3.1, and its spec, step 5; voxel size and least number of matches: ours.
    """
    seen = observations(scene.points, len(scene.views))[list(scene.train)]
    if not seen.nnz:
        return scene
    views, positions = scene.train_views, scene.points.positions
    centres = torch.stack([view.camera.centre for view in views])
    pairs = select_pairs(centres, positions, seen, settings)
    edge = cell * footprint(views, positions, seen)
    # the corner of what training views see moves with the scene; the frame's origin does not
    corner = positions[torch.from_numpy(np.unique(seen.indices)).long()].amin(dim=0)
    images, voxels = ImageCache(image_bytes), Voxels(edge, corner)
    with bar(f"matching {len(pairs)} pairs of photos") as report:
        for done, (a, b) in enumerate(pairs):
            shared = positions[seen_by_both(seen, a, b)]
            found = match(views[a], views[b], shared, images, settings)
            voxels.add(found, (scene.train[a], scene.train[b]))
            report(done + 1, len(pairs))
    return extended(scene, voxels.points(), APART * edge)


def footprint(views: Sequence[View], positions: Float[Tensor, "n 3"], seen: csr_array) -> float:
    """Median size of a pixel on what the views see, in scene units: z / f over all observations.

    Args:
        views: The views that look.
        positions: Sparse points in scene units.
        seen: Which of the views sees which point, views x points.
    """
    sizes = [
        project_points(view.camera, positions[points_of(seen, row)])[1] / view.camera.K[0, 0]
        for row, view in enumerate(views)
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
        images: Where photos of the views are kept once they are read.
        settings: Which matches become points.
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

    def __init__(self, edge: float, corner: Float[Tensor, "3"]) -> None:
        """Start empty.

        Args:
            edge: Length of a voxel's edge in scene units, > 0.
            corner: Corner that voxels have at this place, in scene units. Taken from the data, it
                moves with the scene, and so do the voxels.
        """
        self.edge = edge
        self._corner = corner.double().numpy()
        self._keys = np.zeros((0, 3), np.int64)
        self._sums = np.zeros((0, 8))
        self._tracks = np.zeros((0, 4), np.int64)

    def add(self, found: DensePoints, views: tuple[int, int]) -> None:
        """Take the points of one pair in.

        Args:
            found: Any number of points of the pair.
            views: Indices into the scene's views of the two views.
        """
        positions, weights = found.positions.numpy(), found.scores.numpy()[:, None]
        ones = np.ones_like(weights)
        rows = [weights * positions, weights * found.colours.numpy(), weights, ones]
        cells = np.floor((positions - self._corner) / self.edge).astype(np.int64)
        keys, sums = summed(cells, np.hstack(rows))
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
    """Sorted distinct keys and the sum of the rows of each.

    Args:
        keys: Key of each row; three whole numbers.
        rows: Values that are added up.
    """
    distinct, owner = np.unique(keys, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    columns = [np.bincount(owner, column, len(distinct)) for column in rows.T]
    return distinct, np.stack(columns, axis=1)


def ordered(keys: Int64[np.ndarray, "n 3"]) -> np.ndarray:
    """Keys as single values that sort as the rows do."""
    return np.ascontiguousarray(keys).view([("x", "i8"), ("y", "i8"), ("z", "i8")])[:, 0]


def extended(scene: Scene, found: SparsePoints, apart: float) -> Scene:
    """The scene with those points that are at least `apart` from each of its own.

    Args:
        scene: A scene with at least one point.
        found: Points that may join it.
        apart: Least distance in scene units of a point that joins.
    """
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
