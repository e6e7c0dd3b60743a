"""Points where structure from motion has none: training photos matched, triangulated, merged."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.datasets.image_cache import ImageCache
from splatproof.datasets.progress import bar
from splatproof.methods.contracts.run import keep_to_oneself
from splatproof.methods.priors.matches import match_by_prior, require_priors
from splatproof.methods.priors.own_matcher import OwnMatcher, load_own_matcher
from splatproof.methods.priors.roma import load_matcher
from splatproof.methods.training.least_vectors import least_vectors
from splatproof.reference.supervision.dense_initialisation import (
    DensePoints,
    DenseSettings,
    observations,
    points_of,
    points_of_pair,
    rows_of,
    seen_by_both,
    select_pairs,
)
from splatproof.reference.supervision.dense_matching import (
    DenseMatcher,
    match_by_flow,
    plane_between,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints, View

LEAST_MATCHES = 4
"""Number of matches that a voxel needs; with fewer it holds nothing but stray ones."""
FARTHEST = 2**20
"""Voxels from the corner beyond which a match is no place: three such numbers are one of 64 bits."""
APART = 0.7
"""Cells between a new point and the nearest sparse one, at least: the sparse ones are better."""


def with_dense_points(
    scene: Scene,
    cell: float,
    image_bytes: int,
    settings: DenseSettings,
    say: Callable[[str], None] = keep_to_oneself,
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
        settings: Which images form pairs, who matches them, and which matches become points.
        say: Told in one line where no point is added, and why.

    Raises: UsageError where depth priors are to match and a training view has none; MissingError or DataError where
        a network is to, and lacks its package or weights.

    Source: DPGS, Sec. 3.1, and its spec, step 5; voxel size and least number of matches: ours.
    """
    if settings.matcher == "prior":
        require_priors(scene)
    matcher = _network(settings)
    without = f"dense_cell {cell:g}: no points of matched photos are added, for"
    instead = "dense_cell 0 goes without"
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    if len(scene.train) == 1:
        say(f"{without} the only training view has no partner; {instead}")
        return scene
    if not seen.nnz:
        say(f"{without} no sparse point says which training views see it; {instead}")
        return scene
    views, positions = scene.train_views, scene.points.positions
    pairs = chosen_pairs(scene, settings)
    if not pairs:
        low, high = settings.angles
        say(
            f"{without} no two of {len(views)} training views see the same sparse points under {low:g} to {high:g} "
            f"degrees (dense.angles); {instead}"
        )
        return scene
    edge = cell * footprint(views, positions, seen)
    # the corner of what training views see moves with the scene; the frame's origin does not
    shown = positions[torch.from_numpy(np.unique(seen.indices)).long()]
    # no point far beyond all others takes it so far away that no match is within reach
    lowest = shown.median(dim=0).values - FARTHEST // 2 * edge
    corner = shown.amin(dim=0).maximum(lowest)
    images, voxels = ImageCache(image_bytes), Voxels(edge, corner)
    with bar(f"matching {len(pairs)} pairs of photos") as report:
        found = partial(_found, views, positions, seen, images, settings, matcher)
        for done, (pair, points) in enumerate(in_order(found, pairs)):
            voxels.add(points, (scene.train[pair[0]], scene.train[pair[1]]))
            report(done + 1, len(pairs))
    made = extended(scene, voxels.points(), APART * edge)
    if len(made.points) == len(scene.points):
        say(
            f"{without} {len(pairs)} pairs of photos gave none that is sure (dense.certainty, dense.score) and apart from "
            f"the sparse ones; {instead}"
        )
    return made


def chosen_pairs(scene: Scene, settings: DenseSettings) -> list[tuple[int, int]]:
    """The pairs of training views that are matched, as numbers among the training views.

    Args:
        scene: A scene with sparse points and tracks.
        settings: Which images form pairs.
    """
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    return select_pairs(centres, scene.points.positions, seen, settings)


def _network(settings: DenseSettings) -> DenseMatcher | OwnMatcher | None:
    """The network that matches, its weights read; None: no network does."""
    if settings.matcher == "own":
        return load_own_matcher()
    return load_matcher(Path(settings.weights)) if settings.matcher == "roma" else None


def _found(
    views: Sequence[View],
    positions: Float[Tensor, "n 3"],
    seen: csr_array,
    images: ImageCache,
    settings: DenseSettings,
    matcher: DenseMatcher | OwnMatcher | None,
    pair: tuple[int, int],
) -> DensePoints:
    first, second = pair
    shared = positions[seen_by_both(seen, first, second)]
    return match(views[first], views[second], shared, images, settings, matcher)


def in_order(
    work: Callable[[tuple[int, int]], DensePoints], pairs: Sequence[tuple[int, int]]
) -> Iterator[tuple[tuple[int, int], DensePoints]]:
    """Pairs and what they give, in the pairs' order, made on torch's number of threads.

    No more results than threads wait for their turn, so memory does not grow with the pairs.

    Args:
        work: Makes the points of a pair; from several threads at once.
        pairs: Any number.
    """
    threads = torch.get_num_threads()
    waiting: deque[tuple[tuple[int, int], Future[DensePoints]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for pair in pairs:
            waiting.append((pair, pool.submit(work, pair)))
            if len(waiting) > threads:
                first, one = waiting.popleft()
                yield first, one.result()
        for first, one in waiting:
            yield first, one.result()


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
    matcher: DenseMatcher | OwnMatcher | None = None,
) -> DensePoints:
    """Points of two views; pixels that either view's mask hides give none.

    Args:
        first: The view whose pixels are followed.
        second: The view they are found in.
        shared: Sparse points that both see, for the planes that bring the photos together or the priors' scale.
        images: Where photos of the views are kept once they are read.
        settings: Who matches, and which matches become points.
        matcher: The network that matches where roma or ours does.
    """
    image = images.load(first)
    if settings.matcher == "prior":
        warp, certainty = match_by_prior(first, second, shared)
    elif isinstance(matcher, OwnMatcher):
        other = images.load(second)
        warp, certainty = matcher(first.camera, second.camera, image, other, shared)
    elif matcher is not None:
        warp, certainty = matcher(image, images.load(second))
    else:
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
    if second.load_mask is not None:
        certainty = certainty * landing(second.load_mask(), warp)
    return points_of_pair(
        first.camera, second.camera, image, warp.double(), certainty, settings, least_vectors
    )


def landing(mask: Bool[Tensor, "hb wb"], warp: Float[Tensor, "h w 2"]) -> Bool[Tensor, "h w"]:
    """Which pixels of a photo are matched to one that a mask of the other photo does not hide.

    Args:
        mask: True where a pixel of the other photo counts.
        warp: From each pixel to where it lies in the other photo, pixels; beyond it, and where that is no number, any
            pixel's mask holds.
    """
    rows, columns = torch.meshgrid(*map(torch.arange, warp.shape[:2]), indexing="ij")
    last = torch.tensor([mask.shape[1], mask.shape[0]]) - 1
    at = (torch.stack([columns, rows], dim=-1) + 0.5 + warp).nan_to_num()
    column, row = at.clamp(min=0).minimum(last).long().unbind(dim=-1)
    return mask[row, column]


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
        self._keys = np.zeros(0, np.int64)
        self._sums = np.zeros((0, 8))
        self._new: list[tuple[np.ndarray, np.ndarray]] = []
        self._tracks: dict[int, np.ndarray] = {}

    def add(self, found: DensePoints, views: tuple[int, int]) -> None:
        """Take the points of one pair in; those more than a million voxels from the corner are dropped.

        Args:
            found: Any number of points of the pair.
            views: Indices into the scene's views of the two views.
        """
        cells = np.floor((found.positions.numpy() - self._corner) / self.edge)
        near = (np.abs(cells) < FARTHEST).all(axis=1)
        positions, colours = found.positions.numpy()[near], found.colours.numpy()[near]
        weights = found.scores.numpy()[near, None]
        rows = [weights * positions, weights * colours, weights, np.ones_like(weights)]
        keys, sums = summed(packed(cells[near].astype(np.int64)), np.hstack(rows))
        for view in views:
            known = self._tracks.get(view)
            self._tracks[view] = keys if known is None else np.union1d(known, keys)
        self._new.append((keys, sums))
        # merged once they are as many as what is there, so that a pair's cost does not grow with the others
        if sum(len(one) for one, _ in self._new) >= len(self._keys):
            self._merge()

    def _merge(self) -> None:
        keys, sums = zip((self._keys, self._sums), *self._new, strict=True)
        self._keys, self._sums = summed(np.concatenate(keys), np.concatenate(sums))
        self._new = []

    def points(self) -> SparsePoints:
        """One point a voxel with enough matches, in the order of the voxels."""
        self._merge()
        kept = self._sums[:, 7] >= LEAST_MATCHES
        means = self._sums[kept, :6] / self._sums[kept, 6:7]
        known = self._keys[kept]
        owners, views = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for view in sorted(self._tracks):
            rows = np.searchsorted(self._keys, self._tracks[view])
            owners.append(np.searchsorted(known, self._keys[rows[kept[rows]]]))
            views.append(np.full(len(owners[-1]), view))
        owner = np.concatenate(owners)
        starts = np.concatenate([[0], np.bincount(owner, minlength=len(known)).cumsum()])
        # views were visited in rising order, so each voxel's stay in it
        order = np.argsort(owner, kind="stable")
        return SparsePoints(
            positions=torch.from_numpy(means[:, :3]),
            colours=torch.from_numpy((means[:, 3:] * 255).round().clip(0, 255).astype(np.uint8)),
            track_starts=torch.from_numpy(starts),
            track_views=torch.from_numpy(np.concatenate(views)[order]),
        )


def packed(cells: Int64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """One number a cell, in the same order.

    Args:
        cells: Whole numbers from -FARTHEST to FARTHEST, without the ends.
    """
    x, y, z = (cells + FARTHEST).T
    return (x * (2 * FARTHEST) + y) * (2 * FARTHEST) + z


def summed(
    keys: Int64[np.ndarray, " n"], rows: Float64[np.ndarray, "n c"]
) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, "m c"]]:
    """Sorted distinct keys and the sum of the rows of each.

    Args:
        keys: Key of each row.
        rows: Values that are added up, in their order.
    """
    distinct, owner = np.unique(keys, return_inverse=True)
    columns = [np.bincount(owner, column, len(distinct)) for column in rows.T]
    return distinct, np.stack(columns, axis=1).astype(np.float64, copy=False)  # of none: integers


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
