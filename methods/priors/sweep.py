"""Prior `sweep`: disparity from matching a photo with its neighbours, in the scale of its SfM points."""

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.datasets.image_cache import ImageCache
from splatproof.methods.priors.alignment import in_scale
from splatproof.reference.supervision.dense_initialisation import (
    DenseSettings,
    observations,
    points_of,
    rows_of,
    seen_by_both,
    select_pairs,
)
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior, Scene, View

PAIRS = DenseSettings(partners=6, angles=(1.0, 45.0))
"""Neighbours of a view: those that share most points with it under a useful angle."""
SURE = 0.2
"""Least certainty of a match, 0 to 1."""
OFF = 1.5
"""Most pixels between a match and its epipolar line."""
SHARP = 0.1
"""Most change of disparity, as a share of it, that moves a match by half a pixel."""
AGREE = 0.05
"""Share of itself by which a disparity may differ in a neighbour that confirms it."""
IMAGE_BYTES = 2**28


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene.

    Args:
        scene: A scene whose sparse points know which training views see them.
        weights: None; it has none.
        seed: Not used; it draws nothing.
    Raises: UsageError where no training view shares points with another.
    """
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    pairs = select_pairs(centres, scene.points.positions, seen, PAIRS) if seen.nnz else []
    if not pairs:
        raise UsageError(
            f"{scene.name}: no two training views share sparse points, by which depth prior 'sweep' "
            "chooses whom to match; take a protocol that triangulates points, or 'lidar'"
        )
    images, views, positions = ImageCache(IMAGE_BYTES), scene.train_views, scene.points.positions

    def make(index: int) -> DepthPrior:
        first = scene.train.index(index)
        found = []
        for second in [a + b - first for a, b in pairs if first in (a, b)]:
            shared = positions[seen_by_both(seen, first, second)]
            found.append(matched(views[first], views[second], shared, images))
        prior = agreed(found, views[first])
        return in_scale(prior, views[first].camera, positions[points_of(seen, first)])

    return make


def matched(
    first: View, second: View, shared: Float[Tensor, "n 3"], images: ImageCache
) -> tuple[Float[Tensor, "h w"], Float[Tensor, "h w"]]:
    """Disparity of every pixel of a view by one neighbour, and its weight: 0 where it is not sure.

    Args:
        first: The view.
        second: The neighbour.
        shared: Sparse points that both see, for the plane that brings the photos together.
        images: Where photos are kept once they are read.
    """
    here, there = (project_points(view.camera, shared)[0] for view in (first, second))
    image, other = images.load(first), images.load(second)
    plane = plane_between(here, there)
    if plane is None and image.shape != other.shape:
        nothing = torch.zeros(first.size)
        return nothing, nothing
    warp, certainty = match_by_flow(image, other, plane)
    disparity, off, slope = along_ray(first.camera, second.camera, warp.double())
    sure = (certainty >= SURE) & (off <= OFF) & (disparity > 0)
    sure &= 0.5 <= SHARP * disparity * slope
    return disparity.float(), torch.where(sure, certainty * slope**2, 0).float()


def along_ray(
    first: Camera, second: Camera, warp: Float[Tensor, "h w 2"]
) -> tuple[Float[Tensor, "h w"], Float[Tensor, "h w"], Float[Tensor, "h w"]]:
    """The disparity at which a pixel's ray comes nearest to its match, in the second image.

    The point at disparity d on the ray of pixel u lies at (m + d n) / (m_z + d n_z) in the second
    image, with m = K2 R K1^-1 u and n = K2 t. So the match gives two linear equations for d.

    Args:
        first: Camera of the image that was matched.
        second: Camera of the image it was matched with.
        warp: u_B - u_A in pixels, float64.

    Returns: Disparity 1 / z in the first camera (not positive: behind it), pixels between match and
        ray, and pixels by which the match moves for a unit of disparity.
    """
    row, column = torch.meshgrid(
        torch.arange(first.height) + 0.5, torch.arange(first.width) + 0.5, indexing="ij"
    )
    pixel = torch.stack([column, row, torch.ones_like(row)], dim=-1).double()
    between = second.world_to_camera @ torch.linalg.inv(first.world_to_camera)
    m = pixel @ (second.K @ between[:3, :3] @ torch.linalg.inv(first.K)).T
    n = second.K @ between[:3, 3]
    at = pixel[..., :2] + warp
    slope = n[:2] - at * n[2]
    wanted = at * m[..., 2:] - m[..., :2]
    length = slope.square().sum(dim=-1)
    disparity = (slope * wanted).sum(dim=-1) / length.clamp(min=1e-12)
    scale = (m[..., 2] + disparity * n[2]).abs().clamp(min=1e-12)
    off = (wanted - disparity[..., None] * slope).norm(dim=-1) / scale
    return disparity, off, length.sqrt() / scale


def agreed(
    found: list[tuple[Float[Tensor, "h w"], Float[Tensor, "h w"]]], view: View
) -> DepthPrior:
    """The disparity of each pixel that most neighbours confirm; valid where at least two agree.

    Args:
        found: Disparity and weight by each neighbour.
        view: The view; masked pixels are not valid.
    """
    disparity, valid = torch.zeros(view.size), torch.zeros(view.size, dtype=torch.bool)
    if found:
        values, weights = (torch.stack(maps) for maps in zip(*found, strict=True))
        best = torch.zeros(view.size)
        for value, weight in found:
            near = (weights > 0) & ((values - value).abs() <= AGREE * value)
            support = torch.where(near & (weight > 0), weights, 0).sum(dim=0)
            better = (near.sum(dim=0) >= 2) & (support > best)
            mean = torch.where(near, weights * values, 0).sum(dim=0) / support.clamp(min=1e-30)
            disparity, best = (
                torch.where(better, mean, disparity),
                torch.where(better, support, best),
            )
            valid |= better
    if view.load_mask is not None:
        valid &= view.load_mask()
    return DepthPrior(disparity=torch.where(valid, disparity, 0), valid=valid)
