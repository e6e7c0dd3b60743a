"""What a planner knows of a scene before it trains: counted on cameras, points and training photos."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_array
from torch import Tensor

from splatproof.datasets.resize import resample
from splatproof.methods.auto.spreading import evenly
from splatproof.methods.dynamic.sweep_motion import in_motion
from splatproof.methods.dynamic.sweep_points import swept_moments, timed_points
from splatproof.methods.training.initialise import require_points
from splatproof.reference.supervision.dense_initialisation import observations, points_of, rows_of
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, View

SAMPLES = 24
"""Photos that are read for what only photos say, spread evenly."""
CELL = 16
"""Side in pixels of the cells of a photo that are looked through for points."""
SHARED = 0.1
"""Share of a view's points that another view must see too to be a neighbour."""
MOST_COMPARED = 400
"""About as many views are compared with all others."""
SOUND = 8
"""Fewest observations by which a photo's exposure is compared with the others'."""
PAIRS = 8
"""Pairs of neighbouring moments, spread evenly, in which it is looked for what moves: a choice."""
TURNS = 20
"""Times that the effects of points and of photos are fitted to what the others leave."""


@dataclass(frozen=True, kw_only=True)
class SceneFacts:
    """What was measured on the training views. Photos in the size that they are trained in."""

    views: int
    """Number of training views."""
    width: int
    """Pixels of the photo that is in the middle by size."""
    height: int
    """Pixels of the same photo."""
    points: int
    """Number of points that training can start from: sparse ones, and drawn ones where these are none or hardly any."""
    track: float
    """Mean number of training views that see a point; nan where tracks are not known."""
    coverage: float
    """Mean number of training views whose image a point falls into, hidden or not; nan: there are no points."""
    neighbours: float
    """Median number of other training views that see at least a tenth of a view's points."""
    angle: float
    """Median over points of the largest angle between two of its rays, degrees; nan: not known."""
    down: float
    """Least cosine, -1 to 1, of the angle between the direction that a view looks in and straight down."""
    bare: float
    """Share, 0 to 1, of cells of 16 x 16 pixels that no sparse point is seen in."""
    detail: float
    """Standard deviation, in 8-bit steps, of what a photo loses when it is halved and doubled again."""
    noise: float
    """Standard deviation of a photo's noise, in 8-bit steps."""
    exposure: float
    """Standard deviation over photos of their brightness on shared points, natural logarithm; nan:
    too few shared points."""
    moments: int
    """Number of distinct times; 0: times are not known."""
    swept: bool
    """Whether LiDAR sweeps and times of all views are there."""
    moving: float
    """Share, 0 to 1, of the sweeps' returns that lie on things found to be in motion; 0 without sweeps."""
    image_bytes: int
    """Bytes of all training photos as float32."""


@dataclass(frozen=True, kw_only=True)
class Told:
    """What one photo says."""

    detail: float
    """As `SceneFacts` has its mean."""
    noise: float
    """As `SceneFacts` has its median."""
    brightness: tuple[np.ndarray, np.ndarray]
    """Points that its view sees, and the logarithm of its brightness at each."""


def facts_of(scene: Scene) -> SceneFacts:
    """Measure a scene: its training views alone, of which 24 photos are read, one after the other.

    Args:
        scene: As a method gets it.

    Raises: DataError if there is no point or no training view.

    Source: ours; noise: Immerkaer 1996, "Fast Noise Variance Estimation".
    """
    require_points(scene)
    views = scene.train_views
    positions = scene.points.positions
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    counts = np.asarray(seen.sum(axis=0)).ravel()
    chosen = [(row, views[row]) for row in evenly(range(len(views)), SAMPLES)]
    told = [_told(view, positions, seen, row) for row, view in chosen]
    sizes = torch.tensor([view.size for view in views]).double()
    height, width = sizes[sizes.prod(dim=1).argsort(stable=True)[len(views) // 2]].int().tolist()
    swept = all(view.time is not None for view in scene.views) and any(
        view.load_sweep is not None for view in views
    )
    return SceneFacts(
        views=len(views),
        width=width,
        height=height,
        points=len(scene.points),
        track=float(counts[counts > 0].mean()) if counts.any() else math.nan,
        coverage=_coverage(views, positions),
        neighbours=_neighbours(seen),
        angle=_angle(torch.stack([view.camera.centre for view in views]), positions, seen),
        down=min(float(view.camera.rotation[2] @ -scene.up.double()) for view in views),
        bare=float(np.mean([_bare(view, positions, seen, row) for row, view in chosen])),
        detail=float(np.mean([one.detail for one in told])),
        noise=float(np.median([one.noise for one in told])),
        exposure=_exposure([one.brightness for one in told]),
        moments=len({view.time for view in views if view.time is not None}),
        swept=swept,
        moving=moving_share(scene) if swept else 0.0,
        image_bytes=int(sizes.prod(dim=1).sum()) * 12,
    )  # fmt: skip


def without_points(facts: SceneFacts) -> SceneFacts:
    """Facts of a scene whose points were drawn: what drawn points say of overlap and baselines is nothing.

    Args:
        facts: As they were counted with drawn points.
    """
    nothing = math.nan
    return replace(
        facts, track=nothing, coverage=nothing, neighbours=nothing, angle=nothing, bare=1.0
    )


def moving_share(scene: Scene) -> float:
    """Share of the returns that lie on things in motion; 0 where there is no return.

    Of a long drive, pairs of moments are looked at, spread evenly.

    Args:
        scene: With times and LiDAR sweeps.
    """
    times = swept_moments(scene)
    parts = [times]
    if len(times) > 2 * PAIRS:
        firsts = np.linspace(0, len(times) - 2, PAIRS).astype(int)
        parts = [times[first : first + 2] for first in firsts]
    moved = torch.cat([in_motion(timed_points(scene, part), scene.up).moved for part in parts])
    return float(moved.double().mean()) if len(moved) else 0.0


def noise(photo: Float[Tensor, "h w 3"]) -> float:
    """Standard deviation of a photo's noise in 8-bit steps, by a filter that sees no planes and edges.

    Args:
        photo: sRGB in [0, 1].

    Source: Immerkaer 1996, with the median in place of the mean: fine texture counts less.
    """
    level = cv2.cvtColor(photo.numpy(), cv2.COLOR_RGB2GRAY) * 255
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = np.abs(cv2.filter2D(level, -1, kernel))[1:-1, 1:-1]
    return float(np.median(response) / 0.6745 / 6) if response.size else 0.0


def _told(view: View, positions: Float[Tensor, "n 3"], seen: csr_array, row: int) -> Told:
    """Read a view's photo, which nothing keeps here: photos may be large."""
    photo = view.load()
    return Told(
        detail=_detail(photo), noise=noise(photo),
        brightness=_brightness(view, photo, positions, seen, row),
    )  # fmt: skip


def _detail(photo: Float[Tensor, "h w 3"]) -> float:
    height, width, _ = photo.shape
    half = resample(photo, (max(1, width // 2), max(1, height // 2)), "area").numpy()
    again = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
    return float((photo.numpy() - again).std() * 255)


def _coverage(views: Sequence[View], positions: Float[Tensor, "n 3"]) -> float:
    """Mean number of views whose image a point falls into, over points that fall into any."""
    some = positions[:: max(1, len(positions) // 5000)]
    found = torch.zeros(len(some))
    for view in views:
        camera = view.camera
        pixels, depth = project_points(camera, some)
        size = torch.tensor([camera.width, camera.height])
        found += (depth > 0) & ((pixels >= 0) & (pixels < size)).all(dim=1)
    return float(found[found > 0].mean()) if bool((found > 0).any()) else 0.0


def _neighbours(seen: csr_array) -> float:
    """Median number of views that share enough points with a view."""
    views = len(seen.indptr) - 1
    some = range(0, views, max(1, views // MOST_COMPARED))
    shared = (rows_of(seen, some).astype(np.int64) @ seen.T.astype(np.int64)).toarray()
    own = shared[np.arange(len(some)), some].copy()
    shared[np.arange(len(some)), some] = 0
    return float(np.median((shared >= np.maximum(1, SHARED * own)[:, None]).sum(axis=1)))


def _angle(
    centres: Float[Tensor, "v 3"], positions: Float[Tensor, "n 3"], seen: csr_array
) -> float:
    """Median over points of the angle between the outermost of its rays, in degrees.

    The widest pair of rays is found as the ray farthest from the mean ray and the one farthest from it.
    """
    by_point = seen.T.tocsr()
    lengths = np.diff(by_point.indptr)
    rows = np.where(lengths >= 2)[0]
    if not len(rows):
        return math.nan
    rows = rows[:: max(1, len(rows) // 2000)]
    angles = []
    for row in rows:
        ends = by_point.indices[by_point.indptr[row] : by_point.indptr[row + 1]]
        rays = centres[torch.from_numpy(ends).long()].double() - positions[row]
        rays = rays / rays.norm(dim=1, keepdim=True).clamp(min=1e-12)
        far = rays[(rays @ rays.mean(dim=0)).argmin()]
        angles.append(float((rays @ far).min().clamp(-1, 1).acos()))
    return math.degrees(float(np.median(angles)))


def _bare(view: View, positions: Float[Tensor, "n 3"], seen: csr_array, row: int) -> float:
    """Share of a view's cells in which no point that it sees lies; all points where tracks are unknown."""
    camera = view.camera
    own = positions[points_of(seen, row)] if seen.nnz else positions
    pixels, depth = project_points(camera, own)
    cells = torch.floor(pixels[depth > 0] / CELL).long()
    wide, high = math.ceil(camera.width / CELL), math.ceil(camera.height / CELL)
    inside = (cells >= 0).all(dim=1) & (cells[:, 0] < wide) & (cells[:, 1] < high)
    return 1 - len((cells[inside, 1] * wide + cells[inside, 0]).unique()) / (wide * high)


def _brightness(
    view: View,
    photo: Float[Tensor, "h w 3"],
    positions: Float[Tensor, "n 3"],
    seen: csr_array,
    row: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Points that a view sees, and the logarithm of its photo's brightness at each."""
    points = points_of(seen, row)
    pixels, depth = project_points(view.camera, positions[points])
    at = torch.floor(pixels).long()
    high, wide, _ = photo.shape
    inside = (depth > 0) & (at >= 0).all(dim=1) & (at[:, 0] < wide) & (at[:, 1] < high)
    if view.load_mask is not None:  # what is masked is black, whatever the light
        inside[inside.clone()] = view.load_mask()[at[inside, 1], at[inside, 0]]
    level = photo.mean(dim=2)[at[inside, 1], at[inside, 0]].clamp(min=1 / 255)
    return points[inside].numpy(), level.log().numpy()


def _exposure(seen: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Spread of photos' brightness on the points that they share: point and photo effects in turn.

    Each photo's effect is the median over its points, so that what shines or moves counts little.
    """
    photos = [(points, level) for points, level in seen if len(points) >= SOUND]
    if len(photos) < 2:
        return math.nan
    known, owner = np.unique(np.concatenate([points for points, _ in photos]), return_inverse=True)
    count = np.bincount(owner, minlength=len(known))
    shared = count[owner] >= 2
    if not shared.any():
        return math.nan
    photo = np.repeat(np.arange(len(photos)), [len(points) for points, _ in photos])[shared]
    level = np.concatenate([level for _, level in photos]).astype(np.float64)[shared]
    point = owner[shared]
    effect = np.zeros(len(photos))
    for _ in range(TURNS):
        sums = np.bincount(point, level - effect[photo], len(known))
        rest = level - sums[point] / count[point]
        for index in range(len(photos)):
            own = rest[photo == index]
            if len(own) >= SOUND:
                effect[index] = np.median(own)
        effect -= effect.mean()
    return float(effect.std())
