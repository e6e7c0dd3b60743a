"""The layered memory drawn into another view: the guide depth of what it holds, nearest first."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.types.camera import Camera, project_points

STEEPEST = 10.0
"""Slope (depth gained over distance across) up to which neighbouring layers are one surface."""
APART = 2
"""Samples of neighbouring reference pixels lie up to this many pixels apart."""
AROUND = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))
"""Row and column steps to the pixels around one."""
MOST_PIXELS = 4_000_000
"""Pixels that are written at a time; bounds the memory that a render takes."""


def render(
    memory: LayeredDepth, camera: Camera
) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """Guide depth and visibility mask of the memory in another view.

    Each layer is a column as wide as its reference pixel, from its own depth down to the next
    layer of its surface (`column_ends`): so neither flat nor steep surfaces have gaps through
    which hidden layers could be seen, and nothing in the reference view itself changes. Columns
    are drawn as squares along them, at least one pixel wide, and the nearest wins.

    Args:
        memory: The layers to be drawn.
        camera: Camera of the view that they are drawn in; its image has the result's size.

    Returns: z-depth in scene units (0 where nothing was drawn) and where something was drawn.

    Source: StratoSplat, Sec. 3.2 (guide maps); columns: ours.
    """
    positions, reference_depths = column_samples(memory, camera)
    at, z = project_points(camera, positions)
    half = (_footprints(memory, reference_depths, camera, z) / 2).clamp(min=0.5)[:, None]
    size = at.new_tensor([camera.width, camera.height])
    first = (at - half - 0.5).ceil().clamp(min=0).minimum(size)  # pixel centres in the square
    last = (at + half - 0.5).floor().clamp(min=-1).minimum(size - 1)
    drawn = (z > camera.near) & (last >= first).all(dim=1)
    first, last, z = first[drawn].long(), last[drawn].long(), z[drawn]
    counts = (last - first + 1).prod(dim=1)
    nearest = torch.full((camera.height * camera.width,), torch.inf, dtype=z.dtype)
    for part in _parts(counts):
        owner, pixels = _pixels_of(first[part], last[part], camera.width)
        nearest.scatter_reduce_(0, pixels, z[part][owner], "amin")
    depth = nearest.reshape(camera.height, camera.width)
    seen = depth.isfinite()
    return torch.where(seen, depth, 0), seen


def column_ends(memory: LayeredDepth) -> Float[Tensor, " n"]:
    """Depth in the reference camera down to which each layer's surface goes on in its pixel.

    It goes on to the deepest of: the next layer of its own pixel, and in each of the eight pixels
    around it the layer nearest in depth (with four, diagonal slopes have gaps); each only if it is
    deeper, and no deeper than a slope of 10 : 1 reaches. Otherwise the surface ends there, and the
    column at its own depth.

    Args:
        memory: The layers.

    Source: ours.
    """
    camera, depths, pixels = memory.camera, memory.depths, memory.pixels
    if not len(depths):
        return depths
    reach = depths * (1 + STEEPEST * APART / float(camera.K[0, 0]))
    ends = depths.clone()
    same = pixels[1:] == pixels[:-1]
    ends[:-1] = _deeper(ends[:-1], torch.where(same, depths[1:], torch.inf), reach[:-1])
    row, column = pixels // camera.width, pixels % camera.width
    for down, right in AROUND:
        y, x = row + down, column + right
        inside = (y >= 0) & (y < camera.height) & (x >= 0) & (x < camera.width)
        beside = torch.where(inside, y * camera.width + x, -1)
        ends = _deeper(ends, _nearest_depth(memory, beside), reach)
    return ends


def _deeper(
    ends: Float[Tensor, " n"], candidates: Float[Tensor, " n"], reach: Float[Tensor, " n"]
) -> Float[Tensor, " n"]:
    """The deeper of end and candidate, where the candidate is in reach."""
    return torch.where(candidates <= reach, torch.maximum(ends, candidates), ends)


def _nearest_depth(memory: LayeredDepth, beside: Int[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Depth of the layer of another pixel that is nearest in depth to each layer; inf without one."""
    depths, pixels = memory.depths, memory.pixels
    low = depths.min()
    # Pixel and depth in one rising number: layers are sorted by both.
    share = (depths - low) / (2 * (depths.max() - low).clamp(min=1e-300))
    place = torch.searchsorted(pixels + share, beside + share)
    best = torch.full_like(depths, torch.inf)
    for index in (place - 1, place):
        there = index.clamp(0, len(depths) - 1)
        found = torch.where(pixels[there] == beside, depths[there], torch.inf)
        best = torch.where((found - depths).abs() < (best - depths).abs(), found, best)
    return best


def column_samples(
    memory: LayeredDepth, camera: Camera
) -> tuple[Float[Tensor, "m 3"], Float[Tensor, " m"]]:
    """Points along every column, so close that their squares touch in the view.

    Args:
        memory: The layers.
        camera: The view that the columns are drawn in.

    Returns: World positions in scene units, and depths in the reference camera.
    """
    tops, ends = memory.depths, column_ends(memory)
    eye = memory.camera.centre.to(memory.positions)
    rays = memory.positions - eye
    at_top, z_top = project_points(camera, memory.positions)
    at_end, z_end = project_points(camera, eye + rays * (ends / tops)[:, None])
    length = (at_end - at_top).abs().amax(dim=1)
    near, far = torch.minimum(z_top, z_end), torch.maximum(z_top, z_end)
    width = torch.minimum(
        _footprints(memory, tops, camera, z_top), _footprints(memory, ends, camera, z_end)
    ).clamp(min=1)
    # far / near: in perspective the near end of an evenly divided column has the widest steps
    steps = torch.where(near > camera.near, (length / width * far / near).ceil(), 0).long()
    owner = torch.repeat_interleave(torch.arange(len(tops)), steps + 1)
    before = (steps + 1).cumsum(0) - (steps + 1)
    # float32 division of integers would lose digits
    share = (torch.arange(len(owner)) - before[owner]).to(tops) / steps[owner].clamp(min=1)
    depths = tops[owner] + share * (ends - tops)[owner]
    return eye + rays[owner] * (depths / tops[owner])[:, None], depths


def _footprints(
    memory: LayeredDepth,
    reference_depths: Float[Tensor, " m"],
    camera: Camera,
    z: Float[Tensor, " m"],
) -> Float[Tensor, " m"]:
    """Width in the view's pixels of a reference pixel at these depths."""
    return reference_depths / float(memory.camera.K[0, 0]) * float(camera.K[0, 0]) / z


def _parts(counts: Int[Tensor, " m"]) -> list[slice]:
    """Runs of squares with about MOST_PIXELS pixels together."""
    group = counts.cumsum(0) // MOST_PIXELS
    ends = torch.unique_consecutive(group, return_counts=True)[1].cumsum(0).tolist()
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _pixels_of(
    first: Int[Tensor, "m 2"], last: Int[Tensor, "m 2"], width: int
) -> tuple[Int[Tensor, " p"], Int[Tensor, " p"]]:
    """Every pixel of every square: the square's index and the row-major pixel index."""
    sides = last - first + 1
    counts = sides.prod(dim=1)
    owner = torch.repeat_interleave(torch.arange(len(counts)), counts)
    k = torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]
    across = sides[owner, 0]
    return owner, (first[owner, 1] + k // across) * width + first[owner, 0] + k % across
