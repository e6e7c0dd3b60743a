"""Sparse points as structure from motion would leave them: noisy, with gaps, some wrong."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from splatproof.datasets.procedural.ray_images import Frame, pixel_rays
from splatproof.datasets.procedural.units import Number
from splatproof.reference.types.camera import Camera

PIXEL_NOISE = 0.4
"""Standard deviation of an observation in pixels."""
MISS = 0.5
"""Share of true observations that matching misses."""
WRONG = 0.01
"""Share of points that come from a wrong match."""
WRONG_DEPTH = 0.12
"""Standard deviation of the logarithm of a wrong point's depth."""
STEEPEST = 0.2
"""Cosine between view and surface below which a feature is not found again."""
ZOOM = 2.2
"""Largest ratio of distances between the views of a track."""
SAME = 2.5
"""Corners of two views whose places lie within this many pixels are one."""
ROWS_AT_ONCE = 1_000_000
"""Bound on observations linearised together, 0.3 kB each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sparse:
    """Points with their tracks; observations are sorted by point."""

    place: Int[np.ndarray, " n"]
    """Index of each point's true place."""
    positions: Float[np.ndarray, "n 3"]
    colours: UInt8[np.ndarray, "n 3"]
    errors: Float[np.ndarray, " n"]
    """Mean reprojection error in pixels."""
    point: Int[np.ndarray, " m"]
    """Index of the point of each observation."""
    view: Int[np.ndarray, " m"]
    pixel: Float[np.ndarray, "m 2"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Places that a feature detector would find."""

    positions: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    colours: UInt8[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    """Metres from the camera that found the corner."""

    def part(self, rows: Int[np.ndarray, " k"]) -> "Corners":
        """The corners in the given rows."""
        return Corners(
            positions=self.positions[rows], normals=self.normals[rows],
            colours=self.colours[rows], distance=self.distance[rows],
        )  # fmt: skip


def corners(camera: Camera, frame: Frame, count: int, allowed: Bool[np.ndarray, "h w"]) -> Corners:
    """The strongest corners of a picture, lifted to the world by its true depth.

    Args:
        camera: Camera that took the picture.
        frame: Picture and truth.
        count: Corners at most.
        allowed: Pixels on things that stand still.

    Source: Shi and Tomasi 1994, "Good Features to Track".
    """
    grey = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY)
    mask = (allowed & np.isfinite(frame.depth)).astype(np.uint8)
    found = cv2.goodFeaturesToTrack(grey, count, 0.01, 3.0, mask=mask, blockSize=3)
    pixel = np.zeros((0, 2), dtype=int) if found is None else found.reshape(-1, 2).astype(int)
    x, y = pixel[:, 0], pixel[:, 1]
    origins, ways = pixel_rays(camera, pixel + 0.5)
    depth = frame.depth[y, x].astype(np.float64)
    return Corners(
        positions=origins + ways * depth[:, None],
        normals=frame.normal[y, x].astype(np.float64),
        colours=frame.colour[y, x],
        distance=np.linalg.norm(ways, axis=1) * depth,
    )


def merged(found: Sequence[Corners], focal: float) -> Corners:
    """All corners, those that several views found counted once.

    Args:
        found: Corners of each view.
        focal: Focal length in pixels; with SAME it says how close places must lie to be one.
    """
    every = Corners(
        positions=np.concatenate([c.positions for c in found]),
        normals=np.concatenate([c.normals for c in found]),
        colours=np.concatenate([c.colours for c in found]),
        distance=np.concatenate([c.distance for c in found]),
    )
    # one corner a cell; the cell follows the distance in octaves, as features follow scale
    size = SAME / focal * 2 ** np.round(np.log2(every.distance.clip(1e-3)))
    cells = np.floor(every.positions / size[:, None])
    keys = np.column_stack([np.log2(size).round(3), cells])
    _, first = np.unique(keys, axis=0, return_index=True)
    return every.part(np.sort(first))


def seen(
    places: Corners, camera: Camera, depth: Float[np.ndarray, "h w"], zoom: Number = ZOOM
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Which places a view truly sees well enough to match, and where.

    A place is visible where its z lies within the true depths of the 3 x 3 pixels around it. It is
    matched from distances that differ from its finder's by less than a factor.

    Args:
        places: The places.
        camera: Camera of the view.
        depth: True z-depth of the view, in metres; inf where nothing is.
        zoom: That factor, above 1.
    Returns: Indices of the places, and their positions in pixels.
    """
    local = places.positions @ camera.rotation.numpy().T + camera.translation.numpy()
    z = local[:, 2]
    ahead = np.flatnonzero(z > 0.05)
    pixel = local[ahead] @ camera.K.numpy().T
    pixel = pixel[:, :2] / pixel[:, 2:]
    inside = ((pixel > 2) & (pixel < np.array([camera.width, camera.height]) - 2)).all(axis=1)
    rows, pixel = ahead[inside], pixel[inside]
    x, y = pixel.astype(int).T
    near, far = np.full(len(rows), np.inf), np.zeros(len(rows))
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            around = depth[y + dy, x + dx]
            near, far = np.minimum(near, around), np.maximum(far, around)
    slack = 0.002 * z[rows]
    there = (z[rows] > near - slack) & (z[rows] < far + slack) & (z[rows] < 1.1 * near)
    ways = camera.centre.numpy() - places.positions[rows]
    length = np.linalg.norm(ways, axis=1)
    facing = np.einsum("ij,ij->i", ways, places.normals[rows]) > STEEPEST * length
    alike = np.abs(np.log(length / places.distance[rows])) < np.log(zoom)
    keep = there & facing & alike
    return rows[keep], pixel[keep]


def imitate(
    places: Corners,
    cameras: Sequence[Camera],
    sightings: Sequence[tuple[Int[np.ndarray, " _"], Float[np.ndarray, "_ 2"]]],
    seed: int,
) -> Sparse:
    """Observations with misses and noise, triangulated; a few points are wrong.

    Args:
        places: True places.
        cameras: Camera of each view.
        sightings: Places that each view sees, and where, as `seen` returns them.
        seed: Decides misses, noise and wrong points.

    Returns: Points seen by at least 3 views (a wrong one: by 2), reprojecting within 4 pixels.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 5)))
    point = np.concatenate([rows for rows, _ in sightings])
    view = np.concatenate([np.full(len(rows), i) for i, (rows, _) in enumerate(sightings)])
    pixel = np.concatenate([pixels for _, pixels in sightings])
    kept = rng.random(len(point)) > MISS
    order = np.argsort(point[kept], kind="stable")
    point, view, pixel = point[kept][order], view[kept][order], pixel[kept][order]
    pixel = pixel + rng.normal(0, PIXEL_NOISE, pixel.shape)
    enough = np.bincount(point, minlength=len(places.positions)) >= 3
    point, view, pixel = _only(enough, point, view, pixel)
    positions = places.positions.copy()
    for _ in range(3):
        positions = positions + _gauss_newton(positions, cameras, point, view, pixel)
    wrong = enough & (rng.random(len(enough)) < WRONG)
    positions, (point, view, pixel) = _spoil(positions, wrong, cameras, point, view, pixel, rng)
    gap = _gaps(positions, cameras, point, view, pixel)
    count = np.bincount(point, minlength=len(enough)).clip(1)
    errors = np.bincount(point, weights=gap, minlength=len(enough)) / count
    good = enough & (errors < 4)
    point, view, pixel = _only(good, point, view, pixel)
    return Sparse(
        place=np.flatnonzero(good), positions=positions[good], colours=places.colours[good], errors=errors[good],
        point=(np.cumsum(good) - 1)[point], view=view, pixel=pixel,
    )  # fmt: skip


def observed(
    sparse: Sparse,
    places: Corners,
    cameras: Sequence[Camera],
    depths: Iterable[Float[np.ndarray, "_ _"]],
) -> Sparse:
    """The same points as other views observe them, without noise; unobserved ones are left out.

    For views that took no part in the reconstruction: registered to it, not added to it.

    Args:
        sparse: The points.
        places: True places, which `sparse.place` counts.
        cameras: Camera of each of the other views.
        depths: True z-depth of each of these views, in metres; read one after the other.
    """
    found = places.part(sparse.place)
    sightings = [
        seen(found, camera, depth, zoom=1e3) for camera, depth in zip(cameras, depths, strict=True)
    ]
    point = np.concatenate([rows for rows, _ in sightings])
    view = np.concatenate([np.full(len(rows), i) for i, (rows, _) in enumerate(sightings)])
    order = np.argsort(point, kind="stable")
    kept, point = np.unique(point[order], return_inverse=True)
    return Sparse(
        place=sparse.place[kept], positions=sparse.positions[kept], colours=sparse.colours[kept],
        errors=sparse.errors[kept], point=point, view=view[order],
        pixel=np.concatenate([pixel for _, pixel in sightings])[order],
    )  # fmt: skip


def _only(wanted, point, view, pixel):
    """Observations of wanted points."""
    rows = wanted[point]
    return point[rows], view[rows], pixel[rows]


def _residuals(positions, cameras, point, view, pixel):
    """Observed minus projected, and the projection's derivative by the position."""
    rotation = np.stack([c.rotation.numpy() for c in cameras])[view]
    shift = np.stack([c.translation.numpy() for c in cameras])[view]
    intrinsics = np.stack([c.K.numpy() for c in cameras])[view]
    local = np.einsum("nij,nj->ni", rotation, positions[point]) + shift
    z = local[:, 2:].clip(1e-6)
    focal = intrinsics[:, [0, 1], [0, 1]]
    flat = local[:, :2] / z
    derivative = (rotation[:, :2] - flat[..., None] * rotation[:, 2:]) * (focal / z)[..., None]
    return pixel - (flat * focal + intrinsics[:, :2, 2]), derivative


def _slices(count):
    """Slices of at most ROWS_AT_ONCE rows."""
    return [slice(i, i + ROWS_AT_ONCE) for i in range(0, count, ROWS_AT_ONCE)]


def _gaps(positions, cameras, point, view, pixel):
    """Distance in pixels between each observation and the projection of its point."""
    gaps = np.zeros(len(point))
    for rows in _slices(len(point)):
        residual, _ = _residuals(positions, cameras, point[rows], view[rows], pixel[rows])
        gaps[rows] = np.linalg.norm(residual, axis=1)
    return gaps


def _gauss_newton(positions, cameras, point, view, pixel):
    """One step of triangulation for all points at once."""
    normal = np.tile(np.eye(3) * 1e-9, (len(positions), 1, 1))
    right = np.zeros_like(positions)
    for rows in _slices(len(point)):
        residual, derivative = _residuals(positions, cameras, point[rows], view[rows], pixel[rows])
        np.add.at(normal, point[rows], np.einsum("nki,nkj->nij", derivative, derivative))
        np.add.at(right, point[rows], np.einsum("nki,nk->ni", derivative, residual))
    return np.linalg.solve(normal, right[..., None])[..., 0]


def _spoil(positions, wrong, cameras, point, view, pixel, rng):
    """Move wrong points along the ray of their first view; only two views still claim them."""
    first = np.unique(point, return_index=True)
    place = dict(zip(first[0].tolist(), first[1].tolist(), strict=True))
    keep = np.ones(len(point), dtype=bool)
    positions = positions.copy()
    for index in np.flatnonzero(wrong).tolist():
        start = place[index]
        eye = cameras[view[start]].centre.numpy()
        positions[index] = eye + (positions[index] - eye) * np.exp(rng.normal(0, WRONG_DEPTH))
        keep[start + 2 : np.searchsorted(point, index, side="right")] = False
    point, view, pixel = point[keep], view[keep], pixel[keep].copy()
    moved = wrong[point]
    residual, _ = _residuals(positions, cameras, point[moved], view[moved], pixel[moved])
    # the wrong match agrees with the wrong place, within the noise
    pixel[moved] -= residual - rng.normal(0, PIXEL_NOISE, residual.shape)
    inside = np.ones(len(point), dtype=bool)
    size = np.array([[c.width, c.height] for c in cameras])[view]
    inside[moved] = ((pixel[moved] > 0) & (pixel[moved] < size[moved])).all(axis=1)
    return positions, (point[inside], view[inside], pixel[inside])
