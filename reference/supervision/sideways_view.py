"""Sideways views: what a model shows beside a photo's camera must look like the photo, once warped back into it."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.supervision.side_views import inside_image, sample, unproject
from splatproof.reference.types.camera import Camera, project_points

SHARE = 0.05
"""Shift of what lies at the median depth, as a share of the image's width."""


def sideways(camera: Camera, depth: Float[Tensor, ""], share: float = SHARE) -> Camera:
    """The camera moved along its own x axis, so that what lies at a depth shifts by a share of the width.

    Args:
        camera: Camera of a photo.
        depth: z-depth that the shift is of, in scene units, > 0; without gradient.
        share: Shift as a share of the image's width; negative: to the left.

    Source: BlockGaussian, its pseudo-view constraint: d = 0.05 W median(D) / f_x. Its release multiplies
        element by element where the shift should be along the camera's axis.
    """
    away = share * camera.width * depth.detach() / camera.K[0, 0].to(depth)
    pose = camera.world_to_camera.clone()
    pose[0, 3] = pose[0, 3] - away.to(pose)
    return replace(camera, world_to_camera=pose)


def warped_back(
    image: Float[Tensor, "h w 3"], beside: Camera, camera: Camera, depth: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "h w 3"], Bool[Tensor, "h w"]]:
    """What an image from beside shows at each pixel's surface, and where it shows it at all.

    Args:
        image: What was drawn at `beside`.
        beside: Where it was drawn.
        camera: Camera of the pixels.
        depth: Their z-depth in scene units; 0 where there is none.

    Returns: Colours, bilinear, and the pixels whose surface lies in the image, in front of its camera.
    """
    # A place in the plane of a camera has no pixel: its gradient would be no number.
    places = unproject(camera, depth)
    _, z = project_points(beside, places.detach())
    ahead = z > beside.near
    middle = beside.centre + beside.rotation[2]
    at, _ = project_points(beside, torch.where(ahead[:, None], places, middle.to(places)))
    there = inside_image(beside, at) & ahead & (depth.reshape(-1) > 0)
    colours = sample(image, at).reshape(*depth.shape, 3)
    return colours, there.reshape(depth.shape)


def sideways_loss(
    image: Float[Tensor, "h w 3"],
    beside: Camera,
    photo: Float[Tensor, "h w 3"],
    camera: Camera,
    depth: Float[Tensor, "h w"],
    counts: Bool[Tensor, "h w"],
) -> Float[Tensor, ""]:
    """Mean |warped back - photo| over the pixels that count and that are seen from beside; 0 without any.

    Gradients reach the image, and the depth by where it is looked up.

    Args:
        image: What was drawn at `beside`.
        beside: From `sideways`.
        photo: The photo of `camera`, in [0, 1].
        camera: Camera of the photo.
        depth: Rendered z-depth of the photo's pixels in scene units.
        counts: Pixels of which the depth is one.

    Source: BlockGaussian, its pseudo-view constraint, as intended: its release compares where nothing is
        seen, and samples half a pixel off.
    """
    colours, there = warped_back(image, beside, camera, depth)
    taken = there & counts
    off = (colours - photo).abs().mean(dim=2)
    return torch.where(taken, off, 0).sum() / taken.sum().clamp(min=1)


def inverse_depth_loss(
    depth: Float[Tensor, "h w"], disparity: Float[Tensor, "h w"], counts: Bool[Tensor, "h w"]
) -> Float[Tensor, ""]:
    """Mean |1 / D - d| over the pixels that count, in units of their median d; 0 without any.

    Args:
        depth: Rendered z-depth D in scene units; > 0 where it counts.
        disparity: d of a prior in the scene's scale, in 1 / scene units.
        counts: Pixels where both say something, and d > 0.

    Source: BlockGaussian, its depth term, in the scene's own unit there (ours: another unit changes nothing).
    """
    counts = counts & (disparity > 0)
    if not bool(counts.any()):
        return depth.new_zeros(())
    told = disparity[counts]
    return (1 / depth[counts] - told).abs().mean() / told.median()
