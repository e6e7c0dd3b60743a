"""BlockGaussian's and StitchGS' partition: rectangles halved until none holds too many points."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.reference.partition.boxes import OrientedBox

HEIGHT_TRIM = 0.01
"""Share of the points that may lie below, and above, the vertical bounds."""
HEIGHT_RIM = 0.2
"""The vertical bounds are widened by this share of their distance on each side."""


@dataclass(frozen=True, kw_only=True)
class DensitySettings:
    """When to stop halving; both papers cut by the count of sparse points."""

    max_points: int = 300_000
    """A rectangle with more points than this is halved."""
    max_depth: int = 2
    """A rectangle is halved at most this often: at most 2^max_depth blocks."""
    max_blocks: int | None = None
    """Stop at this many blocks; the rectangle with the most points goes first. None: no limit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rectangles:
    """Rectangles that tile a root rectangle on the ground without overlap."""

    axes: Float[Tensor, "2 2"]
    """Rows: the root's two edge directions on the ground."""
    root: Float[Tensor, "2 2"]
    """Lower and upper corner of the root along its own axes."""
    lows: Float[Tensor, "k 2"]
    highs: Float[Tensor, "k 2"]


def smallest_rectangle(
    ground: Float[Tensor, "n 2"],
) -> tuple[Float[Tensor, "2 2"], Float[Tensor, "2 2"]]:
    """Rectangle of smallest area around the points: its axes, and its corners along them.

    One edge of it lies along an edge of the convex hull. Points on one line, or fewer than three,
    get the line's direction; the rectangle then has no area.

    Raises: DataError without points.

    Source: BlockGaussian's release (root of the region of interest); around all points: ours.
    """
    if len(ground) == 0:
        raise DataError("a rectangle around no points: expected at least one point")
    points = ground.double().numpy()
    try:
        hull = points[ConvexHull(points).vertices]
        edges = np.roll(hull, -1, axis=0) - hull
    except (QhullError, ValueError):  # flat input
        middle = points - points.mean(axis=0)
        edges = np.linalg.svd(middle.T @ middle)[2][:1]
    best = None
    for edge in edges / np.linalg.norm(edges, axis=1, keepdims=True):
        axes = np.array([edge, [-edge[1], edge[0]]])
        area = np.ptp(points @ axes.T, axis=0).prod()
        if best is None or area < best[0]:
            best = (area, axes)
    assert best is not None
    axes = torch.from_numpy(best[1])
    local = along(ground, axes)
    return axes, torch.stack([local.amin(dim=0), local.amax(dim=0)])


def along(ground: Float[Tensor, "n 2"], axes: Float[Tensor, "2 2"]) -> Float[Tensor, "n 2"]:
    """Coordinates along two axes; element by element, so that a point's never depend on the others.

    A matrix product may round differently for another number of points, and a point on a shared
    edge would change its owner.

    Args:
        ground: Points (x, y) in the ground frame, scene units.
        axes: Rows: two orthonormal directions on the ground.
    """
    points = ground.double()
    return points[:, :1] * axes[:, 0] + points[:, 1:] * axes[:, 1]


def split(ground: Float[Tensor, "n 2"], settings: DensitySettings) -> Rectangles:
    """Halve the fullest rectangle across its longer edge until none has more than max_points.

    Going by the fullest first gives the same rectangles as recursion, and lets a number of blocks
    be asked for. Cuts are at the middle of the edge, not at the median of the points.

    Args:
        ground: Points on the ground (x, y), not filtered.
        settings: Number of points, halvings and blocks at which to stop.

    Raises: DataError without points; UsageError for settings that allow no block.

    Source: BlockGaussian, Sec. 3.2 and its release; StitchGS, Sec. 3.2.1.
    """
    if settings.max_depth < 0 or (settings.max_blocks is not None and settings.max_blocks < 1):
        raise UsageError(f"{settings}: expected max_depth >= 0 and max_blocks >= 1")
    axes, root = smallest_rectangle(ground)
    local = along(ground, axes)
    done: list[tuple[Tensor, Tensor]] = []
    open_ = [(root[0], root[1], torch.ones(len(local), dtype=torch.bool), 0)]
    limit = settings.max_blocks or 2**settings.max_depth
    while open_:
        open_.sort(key=lambda leaf: -int(leaf[2].sum()))  # stable: ties stay in order
        low, high, held, depth = open_.pop(0)
        full = len(done) + len(open_) + 1 >= limit
        if full or depth == settings.max_depth or int(held.sum()) <= settings.max_points:
            done.append((low, high))
            continue
        axis = int((high - low).argmax())
        middle = (low[axis] + high[axis]) / 2
        ends, starts = high.clone(), low.clone()
        ends[axis] = starts[axis] = middle
        below = local[:, axis] < middle
        open_ += [(low, ends, held & below, depth + 1), (starts, high, held & ~below, depth + 1)]
    return Rectangles(
        axes=axes, root=root,
        lows=torch.stack([low for low, _ in done]), highs=torch.stack([high for _, high in done]),
    )  # fmt: skip


def owner_rectangle(rectangles: Rectangles, ground: Float[Tensor, "n 2"]) -> Int64[Tensor, " n"]:
    """Rectangle that owns each ground position; -1 outside the root. Shared edges belong above.

    The merge rule, with keeps_height: block k keeps the Gaussians in its unwidened rectangle.
    Comparing half-open, each position inside the root has exactly one owner.

    Args:
        rectangles: The tiles, from `split`.
        ground: Positions (x, y) in the ground frame, scene units.
    """
    local = along(ground, rectangles.axes)
    at_end = rectangles.highs == rectangles.root[1]
    above = local[:, None] >= rectangles.lows
    below = (local[:, None] < rectangles.highs) | (at_end & (local[:, None] == rectangles.highs))
    held = (above & below).all(dim=2)
    return torch.where(held.any(dim=1), held.long().argmax(dim=1), -1)


def height_bounds(heights: Float[Tensor, " n"]) -> tuple[float, float]:
    """Vertical bounds: 1st and 99th percentile, moved apart by 20 % of their distance each.

    The release moves the lower bound by 20 % of a distance that it has already widened.

    Raises: DataError without points.

    Source: BlockGaussian's release; symmetric: ours.
    """
    if len(heights) == 0:
        raise DataError("vertical bounds of no points: expected at least one point")
    low, high = np.quantile(heights.double().numpy(), [HEIGHT_TRIM, 1 - HEIGHT_TRIM])
    rim = HEIGHT_RIM * (high - low)
    return float(low - rim), float(high + rim)


def keeps_height(heights: Float[Tensor, " n"], bounds: tuple[float, float]) -> Bool[Tensor, " n"]:
    """Which Gaussians the merge keeps: heights within the bounds, lengthened by 1.2 in all.

    Args:
        heights: Heights of the Gaussians' means (z of the ground frame), scene units.
        bounds: Lower and upper bound (height_bounds).

    Source: BlockGaussian's release (block fusion).
    """
    middle, half = (bounds[0] + bounds[1]) / 2, (bounds[1] - bounds[0]) / 2
    return (heights - middle).abs() <= 1.2 * half


def oriented_boxes(
    rectangles: Rectangles, frame: Float[Tensor, "3 3"], heights: tuple[float, float]
) -> tuple[OrientedBox, ...]:
    """The rectangles as oriented boxes in the world, between two heights.

    Args:
        rectangles: The tiles, from `split`, on the ground of `frame`.
        frame: Rotation into the ground frame (ground_frame).
        heights: Lower and upper bound (height_bounds).

    Raises: DataError for a rectangle or a height without extent.

    Source: StitchGS, Sec. 3.2.1 (oriented bounding boxes).
    """
    turn = torch.eye(3, dtype=frame.dtype)
    turn[:2, :2] = rectangles.axes.to(frame)
    vertical = frame.new_tensor(heights).expand(len(rectangles.lows), 2)
    low = torch.cat([rectangles.lows.to(frame), vertical[:, :1]], dim=1)
    high = torch.cat([rectangles.highs.to(frame), vertical[:, 1:]], dim=1)
    rotation = turn @ frame
    return tuple(
        OrientedBox(centre=(a + b) / 2 @ rotation, rotation=rotation, half=(b - a) / 2)
        for a, b in zip(low, high, strict=True)
    )
