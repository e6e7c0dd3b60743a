"""Where a partition can leave seams: pixels whose surface lies in the rim of two blocks or more."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.seam import INNER, OUTER
from splatproof.reference.partition.boxes import Region
from splatproof.reference.types.camera import Camera


def partition_seam_mask(
    camera: Camera, depth: Float[Tensor, "h w"], regions: Sequence[Region]
) -> Bool[Tensor, "h w"]:
    """Pixels whose surface point X has d_k(X) <= 1.1 for at least two of the partition's regions.

    The paper's mask asks which primitives a merge kept beyond its own block's border: a hard merge
    keeps none there and has no seam by that rule, whatever its image shows. This one asks the
    partition and the surface alone, so that all merges of one partition are scored on the same
    pixels. Where regions tile the scene, those are the pixels around the borders, as wide as the
    competitive rim 1 < d <= 1.1.

    Args:
        camera: Camera that saw the depth.
        depth: z-depth of the surface in scene units; pixels that are not finite are on no seam.
        regions: Regions of the partition's blocks, in the scene's frame.
    Returns: All False for fewer than two regions.
    Source: ours, after StitchGS, Sec. 5.1 (the band) and 3.2.3 (d_i).
    """
    seen = depth.isfinite() & (depth > 0)
    if len(regions) < 2:
        return torch.zeros_like(seen)
    points = surface_points(camera, depth)[seen]
    held = torch.zeros(len(points), dtype=torch.int64)
    for region in regions:
        held += _in_rim(region, points)
    mask = torch.zeros_like(seen)
    mask[seen] = held >= 2
    return mask


def _in_rim(region: Region, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Whether d(p) <= 1.1; regions that can tell it without d(p) deep inside are asked so."""
    clipped = getattr(region, "clipped", None)
    if clipped is None:
        return region.distance(points) <= OUTER
    return clipped(points, INNER, 2 * OUTER - INNER) <= OUTER


def surface_points(camera: Camera, depth: Float[Tensor, "h w"]) -> Float[Tensor, "h w 3"]:
    """X = R^T (z K^-1 (x + 0.5, y + 0.5, 1) - t) of every pixel (x, y), float64.

    Args:
        camera: Camera that saw the depth.
        depth: z-depth in scene units, as large as the camera's image.
    """
    y, x = torch.meshgrid(
        torch.arange(camera.height, dtype=torch.float64) + 0.5,
        torch.arange(camera.width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    rays = torch.stack([x, y, torch.ones_like(x)], dim=2) @ torch.linalg.inv(camera.K.double()).T
    local = rays * depth.double()[..., None]
    return (local - camera.translation.double()) @ camera.rotation.double()
