"""Dense co-visibility initialisation: match pairs, triangulate, score, merge in voxels."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.types.camera import Camera, project_points


@dataclass(frozen=True, kw_only=True)
class DenseSettings:
    """Thresholds of the initialisation. The paper gives no values: these are ours, to be swept."""

    certainty: float = 0.3
    """tau_c: matches below are dropped. In [0, 1]."""
    sigma: float = 1.0
    """Geometric sensitivity of the score, in pixels at working resolution."""
    score: float = 0.3
    """tau_s: points below are dropped. In [0, 1]."""
    partners: int = 4
    """Pairs are formed with this many most co-visible images."""
    angles: tuple[float, float] = (2.0, 45.0)
    """Baseline angle at the median shared point, degrees: pairs outside are not used."""
    ray_angle: float = 1.5
    """Smallest angle between the two rays of a match, degrees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DensePoints:
    """Coloured points with their reliability."""

    positions: Float[Tensor, "n 3"]
    colours: Float[Tensor, "n 3"]
    scores: Float[Tensor, " n"]


def select_pairs(
    centres: Float[Tensor, "v 3"],
    points: Float[Tensor, "n 3"],
    seen: Bool[Tensor, "v n"],
    settings: DenseSettings,
) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of each image with its most co-visible partners at a useful angle.

    Args:
        centres: Camera centres, scene units.
        points: Sparse points, scene units.
        seen: Which view's track holds which point.
        settings: Number of partners, and range of angles.

    Returns: Sorted, without repeats. Ties in co-visibility go to the lower index.

    Source: DPGS, Sec. 3.1; numbers of partners and angles: ours.
    """
    shared = seen.double() @ seen.double().T
    shared.fill_diagonal_(0)
    low, high = settings.angles
    pairs = set()
    for a in range(len(centres)):
        found = 0
        for b in torch.sort(shared[a], descending=True, stable=True).indices.tolist():
            if found == settings.partners or shared[a, b] == 0:
                break
            median = points[seen[a] & seen[b]].median(dim=0).values
            angle = _angle(centres[a] - median, centres[b] - median)
            if low <= float(angle) <= high:
                pairs.add((min(a, b), max(a, b)))
                found += 1
    return sorted(pairs)


def _angle(a: Float[Tensor, "*n 3"], b: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n"]:
    """Angle between vectors in degrees; exact for tiny angles too, 0 where one is zero."""
    across = torch.linalg.cross(a, b).norm(dim=-1)
    return torch.rad2deg(torch.atan2(across, (a * b).sum(dim=-1)))


def triangulate(
    camera_a: Camera,
    camera_b: Camera,
    pixels_a: Float[Tensor, "n 2"],
    pixels_b: Float[Tensor, "n 2"],
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Two-view linear triangulation (DLT) in normalised coordinates, and the rays' angle.

    Args:
        camera_a: Camera of image A.
        camera_b: Camera of image B.
        pixels_a: Pixel positions (x, y) of the matches in image A, centres at .5.
        pixels_b: Pixel positions (x, y) of the same points in image B.

    Returns: World points (non-finite where the rays are parallel) and angles in degrees.

    Source: Hartley and Zisserman, "Multiple View Geometry", Sec. 12.2.
    """
    rows, directions = [], []
    for camera, pixels in ((camera_a, pixels_a), (camera_b, pixels_b)):
        ray = torch.cat([pixels, torch.ones_like(pixels[:, :1])], dim=1)
        ray = ray @ torch.linalg.inv(camera.K).to(ray).T
        pose = camera.world_to_camera[:3].to(ray)
        rows += [ray[:, i, None] * pose[2] - pose[i] for i in (0, 1)]
        directions.append(ray @ camera.rotation.to(ray))
    _, _, axes = torch.linalg.svd(torch.stack(rows, dim=1))
    homogeneous = axes[:, 3]
    return homogeneous[:, :3] / homogeneous[:, 3:], _angle(directions[0], directions[1])


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
    positions, angle = triangulate(camera_a, camera_b, at_a, at_b)
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
    _, owner = torch.unique(cells, dim=0, return_inverse=True)
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
