"""Dense co-visibility initialisation: match pairs, triangulate, score, merge in voxels."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.cells import unique_rows
from splatproof.reference.types.scene import SparsePoints

Solver = Callable[[Float[Tensor, "n 4 4"]], Float[Tensor, "n 4"]]
"""The unit vectors that make |A h| least, of either sign."""
Matcher = Literal["flow", "prior", "own", "roma"]
AT_ONCE = 1_000_000
"""Observations, about, that are looked through at once for pairs of views."""


@dataclass(frozen=True, kw_only=True)
class DenseSettings:
    """Thresholds of the initialisation. The paper gives no values: these are ours, to be swept."""

    certainty: float = 0.3
    """Certainty, 0 to 1, below which a match is dropped (tau_c)."""
    sigma: float = 1.0
    """Reprojection error in pixels of the matched photos, > 0, at which a match has lost 39 % of its
    score."""
    score: float = 0.3
    """Score, 0 to 1, below which a point is dropped (tau_s)."""
    partners: int = 4
    """Number of photos that each photo is matched with, >= 1: those that share most points with it."""
    angles: tuple[float, float] = (2.0, 45.0)
    """Least and largest angle, degrees in [0, 180], under which the median shared point sees the two
    cameras of a pair."""
    ray_angle: float = 1.5
    """Least angle between the two rays of a match, degrees in [0, 180]."""
    matcher: Matcher = "flow"
    """Who says where a photo's pixels lie in the other. flow: optical flow both ways; prior: the depth priors
    of both, a bound on all matchers where they are the true depth; own: a small network of ours that knows the poses,
    with weights that come along; roma: the network of the paper, with weights of one's own."""
    weights: str = ""
    """Folder of roma's weights, as their authors name them: tiny_roma_v1_outdoor.pth, or roma_outdoor.pth and
    dinov2_vitl14_pretrain.pth; nothing is fetched."""

    def __post_init__(self) -> None:
        """Refuse thresholds that mean nothing."""
        low, high = self.angles
        needs = self.matcher == "roma"
        told = "the folder of its weights" if needs else f"none: matcher is {self.matcher!r}"
        for name, fine, expected in (
            ("certainty", 0 <= self.certainty <= 1, "0 to 1"),
            ("sigma", 0 < self.sigma < math.inf, "> 0"),
            ("score", 0 <= self.score <= 1, "0 to 1"),
            ("partners", self.partners >= 1, ">= 1"),
            ("angles", 0 <= low <= high <= 180, "0 <= least <= largest <= 180"),
            ("ray_angle", 0 <= self.ray_angle <= 180, "0 to 180"),
            ("weights", needs == bool(self.weights), told),
        ):
            if not fine:
                raise UsageError(f"{name} = {getattr(self, name)!r}: expected {expected}")


@dataclass(frozen=True, kw_only=True, eq=False)
class DensePoints:
    """Coloured points with their reliability."""

    positions: Float[Tensor, "n 3"]
    colours: Float[Tensor, "n 3"]
    scores: Float[Tensor, " n"]


def observations(points: SparsePoints, views: int) -> csr_array:
    """The tracks turned round: which points each view sees.

    Args:
        points: Sparse points with their tracks.
        views: Number of views of the scene.

    Returns: Boolean views x points matrix with one stored entry an observation, a row's points in
        rising order; a view's row is empty if no track names it.
    """
    seen = csr_array(
        (np.ones(len(points.track_views), bool), points.track_views.numpy(),
         points.track_starts.numpy()),
        shape=(len(points), views),
    )  # fmt: skip
    return seen.T.tocsr()


def rows_of(seen: csr_array, views: Sequence[int]) -> csr_array:
    """What some views see, as a matrix of their rows alone.

    Args:
        seen: See `observations`.
        views: Rows to take, in the order wanted.
    """
    return _rows(seen, list(views))


def points_of(seen: csr_array, view: int) -> Int[Tensor, " m"]:
    """Points that a view sees.

    Args:
        seen: See `observations`.
        view: Row of the view.

    Returns: Indices of the points, rising.
    """
    return torch.from_numpy(seen.indices[seen.indptr[view] : seen.indptr[view + 1]]).long()


def seen_by_both(seen: csr_array, first: int, second: int) -> Int[Tensor, " m"]:
    """Points that two views share.

    Args:
        seen: See `observations`.
        first: Row of one view.
        second: Row of the other view.

    Returns: Indices of the points, rising.
    """
    a, b = points_of(seen, first).numpy(), points_of(seen, second).numpy()
    return torch.from_numpy(np.intersect1d(a, b, assume_unique=True))


def select_pairs(
    centres: Float[Tensor, "v 3"],
    points: Float[Tensor, "n 3"],
    seen: csr_array,
    settings: DenseSettings,
) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of each image with its most co-visible partners at a useful angle.

    All images look for their partners at once, each at its next best one in each round: of a video, whose next photos all
    lie under too small an angle, that takes as many rounds as there are such photos. Memory grows with the pairs of
    views that share a point and with the observations, not with views x points.

    Args:
        centres: Camera centres in scene units.
        points: Sparse points in scene units.
        seen: Which view sees which point, views x points; see `observations`.
        settings: Number of partners, and the angles that are useful.

    Returns: Sorted, without repeats. Ties in co-visibility go to the lower index.

    Source: DPGS, Sec. 3.1; numbers of partners and angles: ours.
    """
    counted = seen.astype(np.int32)
    shared = (counted @ counted.T).tocoo()
    first, second = shared.coords
    order = np.lexsort((second, -shared.data, first))
    order = order[first[order] != second[order]]
    first, second = first[order], second[order]
    coming, ends = (
        np.searchsorted(first, np.arange(len(centres)), side) for side in ("left", "right")
    )
    by_value = [np.argsort(points[:, axis].numpy(), kind="stable") for axis in range(3)]
    sorted_seen = [cast(csr_array, seen[:, order]).sorted_indices() for order in by_value]
    found = np.zeros(len(centres), np.int64)
    low, high = settings.angles
    pairs = set()
    while len(a := np.flatnonzero((found < settings.partners) & (coming < ends))):
        b = second[coming[a]]
        middle = [
            order[_middle(rows, a, b)] for order, rows in zip(by_value, sorted_seen, strict=True)
        ]
        medians = torch.stack([points[middle[axis], axis] for axis in range(3)], dim=1)
        angle = _angle(centres[a] - medians, centres[b] - medians).numpy()
        useful = (low <= angle) & (angle <= high)
        ends_of = (np.minimum(a, b)[useful].tolist(), np.maximum(a, b)[useful].tolist())
        pairs |= set(zip(*ends_of, strict=True))
        coming[a] += 1
        found[a] += useful
    return sorted(pairs)


def _rows(seen: csr_array, chosen: list[int] | np.ndarray) -> csr_array:
    return cast(csr_array, seen[chosen])  # scipy has no types, and its index has many forms


def _middle(seen: csr_array, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The lower middle one of the points that each of some pairs of views share, in the order of the columns."""
    size = max(1, AT_ONCE // int(np.diff(seen.indptr).max()))
    found = []
    for begin in range(0, len(first), size):
        part = slice(begin, begin + size)
        both = (_rows(seen, first[part]) * _rows(seen, second[part])).tocsr()
        found.append(both.indices[(both.indptr[:-1] + both.indptr[1:] - 1) // 2])
    return np.concatenate(found)


def _angle(a: Float[Tensor, "*n 3"], b: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n"]:
    """Angle between vectors in degrees; exact for tiny angles too, 0 where one is zero."""
    across = torch.linalg.cross(a, b).norm(dim=-1)
    return torch.rad2deg(torch.atan2(across, (a * b).sum(dim=-1)))


def least_vectors(systems: Float[Tensor, "n 4 4"]) -> Float[Tensor, "n 4"]:
    """Right singular vector of the smallest singular value of each system.

    Args:
        systems: Homogeneous equations A, one a row.
    """
    return torch.linalg.svd(systems)[2][:, 3]


def triangulate(
    camera_a: Camera,
    camera_b: Camera,
    pixels_a: Float[Tensor, "n 2"],
    pixels_b: Float[Tensor, "n 2"],
    solver: Solver = least_vectors,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Two-view linear triangulation (DLT) in normalised coordinates, and the rays' angle.

    Solved with camera A at the origin and the baseline as unit: the homogeneous least squares
    weighs its errors by where the origin is and by the unit, which must not matter.

    Args:
        camera_a: Camera of image A.
        camera_b: Camera of image B, at another place than camera A.
        pixels_a: Positions in image A, pixels.
        pixels_b: Positions of the same things in image B, pixels.
        solver: What solves the homogeneous equations.

    Returns: World points (non-finite where the rays are parallel) and angles in degrees.

    Source: Hartley and Zisserman, "Multiple View Geometry", Sec. 12.2; origin and unit: ours.
    """
    origin = camera_a.centre.to(pixels_a)
    baseline = (camera_b.centre.to(pixels_a) - origin).norm()
    rows, directions = [], []
    for camera, pixels in ((camera_a, pixels_a), (camera_b, pixels_b)):
        ray = torch.cat([pixels, torch.ones_like(pixels[:, :1])], dim=1)
        ray = ray @ torch.linalg.inv(camera.K).to(ray).T
        rotation = camera.rotation.to(ray)
        shift = rotation @ (origin - camera.centre.to(ray)) / baseline
        pose = torch.cat([rotation, shift[:, None]], dim=1)
        rows += [ray[:, i, None] * pose[2] - pose[i] for i in (0, 1)]
        directions.append(ray @ rotation)
    homogeneous = solver(torch.stack(rows, dim=1))
    points = origin + baseline * homogeneous[:, :3] / homogeneous[:, 3:]
    return points, _angle(directions[0], directions[1])


def reliability(
    certainty: Float[Tensor, " n"],
    error_a: Float[Tensor, " n"],
    error_b: Float[Tensor, " n"],
    sigma: float,
) -> Float[Tensor, " n"]:
    """S = C exp(-(e_A^2 + e_B^2) / (2 sigma^2)), in [0, C].

    Args:
        certainty: Certainty C that the matcher gives each match, in [0, 1].
        error_a: Reprojection error in image A, pixels.
        error_b: Reprojection error in image B, pixels.
        sigma: Error in pixels that costs a factor exp(-1/2), > 0.

    Source: DPGS, Eq. 1.
    """
    return certainty * torch.exp(-(error_a.square() + error_b.square()) / (2 * sigma**2))


def points_of_pair(
    camera_a: Camera,
    camera_b: Camera,
    image_a: Float[Tensor, "h w 3"],
    warp: Float[Tensor, "h w 2"],
    certainty: Float[Tensor, "h w"],
    settings: DenseSettings,
    solver: Solver = least_vectors,
) -> DensePoints:
    """Points of one matched pair: u_B = u_A + W(u_A), triangulated, scored and filtered.

    Dropped: certainty < tau_c, u_B outside image B, behind either camera, rays closer than the
    smallest angle, non-finite, score < tau_s. Two views from one place give no points.

    Args:
        camera_a: Camera of image A, at the working resolution.
        camera_b: Camera of image B, at the working resolution.
        image_a: Photo A, sRGB in [0, 1], which colours the points.
        warp: W in pixels: pixel u_A of image A lies at u_A + W(u_A) in image B.
        certainty: Certainty of the match at each pixel of image A, in [0, 1].
        settings: Thresholds of certainty, angle and score, and sigma.
        solver: What solves the equations of the triangulation.

    Source: DPGS, Sec. 3.1.
    """
    height, width = certainty.shape
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    at_a = torch.stack([columns, rows], dim=-1).to(camera_a.K) + 0.5
    at_b = at_a + warp
    size = at_b.new_tensor([camera_b.width, camera_b.height])
    kept = (certainty >= settings.certainty) & (at_b >= 0).all(dim=-1) & (at_b < size).all(dim=-1)
    at_a, at_b, sure = at_a[kept], at_b[kept], certainty[kept].to(at_a)
    colours = image_a[kept]
    if torch.equal(camera_a.centre, camera_b.centre):
        at_a, at_b, sure, colours = at_a[:0], at_b[:0], sure[:0], colours[:0]
    positions, angle = triangulate(camera_a, camera_b, at_a, at_b, solver)
    back_a, z_a = project_points(camera_a, positions)
    back_b, z_b = project_points(camera_b, positions)
    scores = reliability(
        sure, (back_a - at_a).norm(dim=1), (back_b - at_b).norm(dim=1), settings.sigma
    )
    good = (z_a > camera_a.near) & (z_b > camera_b.near) & (angle >= settings.ray_angle)
    good &= positions.isfinite().all(dim=1) & (scores >= settings.score)
    return DensePoints(positions=positions[good], colours=colours[good], scores=scores[good])


def merge_in_voxels(points: DensePoints, size: float) -> DensePoints:
    """One point a voxel: mean weighted by score; its score is the best of its members.

    Several pairs see the same surface; merged, the cloud does not grow with their number.

    Args:
        points: Points of all pairs.
        size: Edge of a voxel, > 0, in scene units. The grid starts at the cloud's lower corner, so
            that moving the scene does not change the result.

    Source: ours (spec: DPGS, step 5).
    """
    if not len(points.scores):
        return points
    cells = ((points.positions - points.positions.amin(dim=0)) / size).floor().long()
    _, owner = unique_rows(cells)
    total = _sum_by(owner, points.scores)
    return DensePoints(
        positions=_sum_by(owner, points.positions * points.scores[:, None]) / total[:, None],
        colours=_sum_by(owner, points.colours * points.scores[:, None].to(points.colours))
        / total[:, None].to(points.colours),
        scores=torch.zeros_like(total).scatter_reduce(0, owner, points.scores, "amax"),
    )


def _sum_by(owner: Int[Tensor, " n"], values: Float[Tensor, "n ..."]) -> Float[Tensor, "m ..."]:
    """Sum of the values of each owner."""
    zeros = values.new_zeros(int(owner.max()) + 1, *values.shape[1:])
    return zeros.index_add(0, owner, values)
