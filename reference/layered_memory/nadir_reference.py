"""The memory's reference camera: a virtual one above all views that sees everything they see."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.supervision.spiral_path import look_at
from splatproof.reference.types.camera import Camera

RISE = 2.0
"""Height above the highest thing, in radii of what the views see. Higher up, more walls are seen
edge-on and fall into few pixels; lower down, the image's border is oblique: 2 is 53 degrees wide."""


def nadir_reference(
    cameras: Sequence[Camera], depths: Sequence[tuple[float, float]], up: Float[Tensor, "3"]
) -> Camera:
    """A pinhole camera that looks straight down and holds the frusta of all views.

    Its pixels are as wide on the middle of the views' depths as the views' own (the median view).

    Args:
        cameras: The training views' cameras, at least one.
        depths: Least and largest z-depth of what each view sees, 0 < least <= largest, scene
            units: the frusta are cut there, for a view that sees the horizon has no end.
        up: Unit vector against gravity.

    Raises: ValueError without a view, or where a view's depths are not positive, in order and finite.

    Source: ours (the paper names no C_ref).
    """
    if not cameras or not all(0 < low <= high < math.inf for low, high in depths):
        raise ValueError(f"need views with 0 < least <= largest depth: {list(depths)}")
    corners = torch.cat(
        [_corners(camera, at) for camera, pair in zip(cameras, depths, strict=True) for at in pair]
    )
    rise = corners @ up
    flat = corners - rise[:, None] * up
    middle = (flat.amin(dim=0) + flat.amax(dim=0)) / 2
    radius = float((flat - middle).norm(dim=1).max())
    eye = middle + (rise.max() + RISE * radius) * up
    pose = look_at(eye, middle + rise.min() * up, up)
    local = (corners - eye) @ pose[:3, :3].T
    extent = (local[:, :2] / local[:, 2:]).abs().amax(dim=0)  # half the image, at depth 1
    spacing = [(a + b) / 2 / float(c.K[0, 0]) for c, (a, b) in zip(cameras, depths, strict=True)]
    focal = float(local[:, 2].median()) / sorted(spacing)[len(spacing) // 2]
    # One pixel more on each side: corners on the border itself would be lost to rounding.
    width, height = (2 * math.ceil(focal * float(half)) + 2 for half in extent)
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]).to(pose)
    return Camera(
        K=intrinsics, world_to_camera=pose, width=width, height=height,
        near=float(local[:, 2].min()) / 2,
    )  # fmt: skip


def _corners(camera: Camera, depth: float) -> Float[Tensor, "4 3"]:
    """World positions of the image's corners at a z-depth."""
    pixels = torch.tensor(
        [[x, y, 1.0] for x in (0, camera.width) for y in (0, camera.height)], dtype=camera.K.dtype
    )
    local = depth * pixels @ torch.linalg.inv(camera.K).T
    return (local - camera.translation) @ camera.rotation
