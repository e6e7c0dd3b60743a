"""Parallel planes that a photo's pixels are looked for on in another photo, and that photo as one of them shows it."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.resize import resample, scale_intrinsics
from splatproof.reference.types.camera import Camera, project_points

STRIDE = 4
"""Both sides of what a network sees are multiples of this, and its coarse cells as large, in pixels."""
LONGEST = 640
"""Most pixels of the longer side that is matched; larger photos are made smaller first."""
STEP = 2.0
"""Pixels that a match moves from one plane to the next, in the median over the photo: half a coarse cell."""
FEWEST, MOST = 8, 96
"""Number of planes. Where MOST do not reach, they lie farther apart than STEP."""
RARE = 0.01
"""Share of the shared points at either end of their range that does not widen it: some are wrong."""
BEYOND, LEAST = 0.3, 0.1
"""Planes go beyond the range of the shared points by this share of it, and by this share of the middle plane at
least: roofs and streets may have no point."""
POINTS = 8
"""Least number of points that a plane is laid through; with fewer the planes face the photo."""
FLATTEST = 0.25
"""Least share of a plane's largest inverse depth in the photo that its smallest may be. Beyond, its horizon is near,
and the planes face the photo."""
ROUNDS, EXACT = 20, 1e-3
"""Rounds of weighted least squares by which a plane has the least absolute errors, and the share of the median
inverse depth below which an error is none."""
AHEAD, NOWHERE = 1e-6, -1e4
"""Least third coordinate of what a plane carries somewhere, and the pixel of what it does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Planes:
    """Planes of a photo A: inverse depth k g . (x, y, 1) at pixel (x, y), with k from the least to the largest.

    Each carries A's pixels into photo B, and from there, by the way back of the middle plane (k = 1), into A's frame
    again, where B shows about what A shows.

    Source: Collins 1996, "A space-sweep approach to true multi-image matching"; planes along the scene's own
        and the frame of the middle one: ours.
    """

    slope: Float[Tensor, "3"]
    """g, in inverse scene units."""
    middle: Float[Tensor, "3 3"]
    """Homography of the middle plane, from A to B."""
    still: Float[Tensor, "3 3"]
    """What no plane moves, from A's pixels into A's frame again."""
    moving: Float[Tensor, "3 3"]
    """What k moves: a pixel goes to (still + k moving) (x, y, 1)."""
    scales: Float[Tensor, " d"]
    """k of each plane, evenly spaced, all > 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two photos as a network sees them."""

    photo: Float[Tensor, "3 h w"]
    """A, its right and lower edge repeated up to a multiple of STRIDE; sRGB in [0, 1]."""
    other: Float[Tensor, "3 h w"]
    """B in A's frame, as if all lay on the middle plane."""
    covered: Bool[Tensor, "h w"]
    """Where B shows that."""
    planes: Planes


def pair_of(
    first: Camera,
    second: Camera,
    image: Float[Tensor, "h w 3"],
    other: Float[Tensor, "hb wb 3"],
    shared: Float[Tensor, "n 3"],
) -> Pair | None:
    """Two photos on the planes between them; None where no plane is seen by both from the same side.

    Args:
        first: Camera of photo A.
        second: Camera of photo B.
        image: Photo A, as large as its camera says, sRGB in [0, 1].
        other: Photo B, as large as its camera says.
        shared: Sparse points that both see, in scene units.
    """
    planes = planes_between(first, second, shared)
    if planes is None:
        return None
    missing = (0, -image.shape[1] % STRIDE, 0, -image.shape[0] % STRIDE)
    photo = functional.pad(image.permute(2, 0, 1)[None], missing, mode="replicate")[0]
    at = carried(planes.middle, pixels(photo.shape[1], photo.shape[2]))
    size = at.new_tensor([second.width, second.height])
    covered = ((at >= 0) & (at < size)).all(dim=-1)
    brought = functional.grid_sample(
        other.permute(2, 0, 1)[None], (2 * at / size - 1).float()[None], padding_mode="border",
        align_corners=False,
    )[0]  # fmt: skip
    return Pair(photo=photo, other=brought, covered=covered, planes=planes)


def window(pair: Pair, rows: slice, columns: slice) -> Pair:
    """A part of a pair, as if no more had been taken of either photo.

    Args:
        pair: The photos.
        rows: Rows that are kept, multiples of STRIDE of them.
        columns: Columns that are kept, multiples of STRIDE of them.
    """
    planes = pair.planes
    out = torch.eye(3, dtype=torch.float64)  # from the part's pixels to the whole's
    out[:2, 2] = out.new_tensor([columns.start, rows.start])
    back = torch.linalg.inv(out)
    kept = replace(
        planes, slope=planes.slope @ out, middle=planes.middle @ out,
        still=back @ planes.still @ out, moving=back @ planes.moving @ out,
    )  # fmt: skip
    return Pair(
        photo=pair.photo[:, rows, columns], other=pair.other[:, rows, columns],
        covered=pair.covered[rows, columns], planes=kept,
    )  # fmt: skip


def planes_between(first: Camera, second: Camera, shared: Float[Tensor, "n 3"]) -> Planes | None:
    """Planes of photo A along the one that the shared points lie about on, or facing A.

    Scale, place and turn of the scene do not matter. None without a shared point before both, and where the middle
    plane shows the two photos different sides, or none of A's pixels is in front of B.

    Args:
        first: Camera of photo A.
        second: Camera of photo B.
        shared: Sparse points that both see, in scene units.
    """
    points = shared.double()
    at, z = project_points(first, points)
    front = (z > 0) & (project_points(second, points)[1] > 0)
    if not front.any():
        return None
    at, inverse = at[front], 1 / z[front]
    slope = _slope(first, at, inverse)
    scale = inverse / (torch.cat([at, torch.ones_like(at[:, :1])], dim=1) @ slope)
    scale = scale[scale > 0]  # others are named by a track and beside the photo
    if not len(scale):
        return None
    low, high = scale.quantile(scale.new_tensor([RARE, 1 - RARE])).tolist()
    room = max(BEYOND * (high - low), LEAST)
    low, high = max(low - room, low / 2), high + room
    between = second.world_to_camera.double() @ torch.linalg.inv(first.world_to_camera.double())
    still = second.K.double() @ between[:3, :3] @ torch.linalg.inv(first.K.double())
    moving = torch.outer(second.K.double() @ between[:3, 3], slope)
    middle = still + moving
    if not float(torch.linalg.det(middle)) > 0:
        return None
    back = torch.linalg.inv(middle)
    found = Planes(
        slope=slope, middle=middle, still=back @ still, moving=back @ moving,
        scales=slope.new_tensor([low, high]),
    )  # fmt: skip
    lattice = pixels(first.height, first.width)[
        :: max(1, first.height // 8), :: max(1, first.width // 8)
    ]
    ends = positions(found, lattice, found.scales[:, None, None].expand(2, *lattice.shape[:2]))
    shown = (ends > NOWHERE).all(dim=-1).all(dim=0)
    if not shown.any():
        return None
    steps = math.ceil(float((ends[1] - ends[0])[shown].norm(dim=-1).median()) / STEP)
    count = min(max(steps + 1, FEWEST), MOST)
    return replace(found, scales=torch.linspace(low, high, count, dtype=torch.float64))


def _slope(
    camera: Camera, at: Float[Tensor, "n 2"], inverse: Float[Tensor, " n"]
) -> Float[Tensor, "3"]:
    """g of the plane with the least absolute errors of inverse depth; of one that faces the photo where none fits."""
    usual = float(inverse.median())
    facing = at.new_tensor([0.0, 0.0, usual])
    if len(at) < POINTS:
        return facing
    to_unit = at.new_tensor([[2 / camera.width, 0, -1], [0, 2 / camera.height, -1], [0, 0, 1]])
    rows = torch.cat([at, torch.ones_like(at[:, :1])], dim=1) @ to_unit.T
    wanted = inverse / usual
    weight, plane = torch.ones_like(wanted), torch.zeros_like(facing)
    for _ in range(ROUNDS):
        root = weight.sqrt()[:, None]
        plane = torch.linalg.lstsq(rows * root, wanted[:, None] * root).solution[:, 0]
        weight = 1 / (rows @ plane - wanted).abs().clamp(min=EXACT)
    lean = float(plane[:2].abs().sum())
    if not float(plane[2]) - lean > FLATTEST * (float(plane[2]) + lean):
        return facing
    return usual * (plane @ to_unit)


def pixels(height: int, width: int, stride: int = 1) -> Float[Tensor, "h w 3"]:
    """Middles (x, y, 1) of cells of a photo, in its pixels, float64.

    Args:
        height: Rows of cells.
        width: Columns of cells.
        stride: Pixels that a cell is wide and high.
    """
    rows, columns = torch.meshgrid(
        torch.arange(height, dtype=torch.float64), torch.arange(width, dtype=torch.float64),
        indexing="ij",
    )  # fmt: skip
    return torch.stack(
        [stride * (columns + 0.5), stride * (rows + 0.5), torch.ones_like(rows)], dim=-1
    )


def carried(plane: Float[Tensor, "3 3"], at: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 2"]:
    """Where a homography carries pixels; NOWHERE behind it.

    Args:
        plane: The homography.
        at: Pixels (x, y, 1).
    """
    return _divided(at @ plane.T)


def positions(
    planes: Planes, at: Float[Tensor, "h w 3"], scales: Float[Tensor, "d h w"]
) -> Float[Tensor, "d h w 2"]:
    """Where pixels of A go on planes of their own, in A's frame.

    Args:
        planes: The planes.
        at: Pixels (x, y, 1), float64.
        scales: k of each pixel, d of them.
    """
    return _divided(at @ planes.still.T + scales.double()[..., None] * (at @ planes.moving.T))


def _divided(there: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 2"]:
    ahead = there[..., 2:] > AHEAD
    return torch.where(ahead, there[..., :2] / there[..., 2:].clamp(min=AHEAD), NOWHERE)


def smaller(
    camera: Camera, image: Float[Tensor, "h w 3"]
) -> tuple[Camera, Float[Tensor, "h2 w2 3"]]:
    """A photo with LONGEST pixels on its longer side at most, and its camera.

    Args:
        camera: The camera, as large as its photo.
        image: sRGB in [0, 1].
    """
    height, width, _ = image.shape
    scale = LONGEST / max(height, width)
    if scale >= 1:
        return camera, image
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    K = scale_intrinsics(camera.K, (width, height), size)
    return replace(camera, K=K, width=size[0], height=size[1]), resample(image, size, "area")
