"""Side-view supervision: which photo guides a side view, where it counts, and its loss."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.reference.supervision.losses import photometric
from splatproof.reference.types.camera import Camera, project_points

EVIDENCE = 2
"""A pixel seen by this many training views is judged by them, not by a refiner."""
SOLID = 0.9
"""Rendered alpha from which a pixel counts as reconstructed."""
HOLE = 0.5
"""Rendered alpha below which a pixel has no surface: more of it is background than scene, and its
expected depth, which haze of any opacity has, says nothing."""
OCCLUSION = 0.02
"""Relative depth difference beyond which the reference photo sees something else."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenView:
    """An image and what was rendered at its camera beside it."""

    camera: Camera
    image: Float[Tensor, "h w 3"]
    """sRGB in [0, 1]: the render of a side view, the photo of a training view."""
    alpha: Float[Tensor, "h w"]
    """Rendered opacity, in [0, 1]."""
    depth: Float[Tensor, "h w"]
    """Rendered z-depth in scene units, 0 where nothing is drawn."""


@runtime_checkable
class ViewRefiner(Protocol):
    """Anything that turns a flawed side view into a plausible one: I_refined = M(I_render, I_ref).

    Source: DPGS, Eq. 3.
    """

    def __call__(self, side: SeenView, photo: SeenView) -> Float[Tensor, "h w 3"]:
        """Return the refined image of the side view, in [0, 1].

        Args:
            side: The flawed side view.
            photo: The training view that guides it.
        """
        ...


def is_side_view_step(step: int, steps: int, every: int) -> bool:
    """Whether the loss applies: every n-th step from the half-way point on (paper: 20k of 40k).

    Args:
        step: Number of the training step, from 0.
        steps: Number of steps of the whole training.
        every: Steps from one use of the loss to the next, at least 1.
    """
    return step >= steps // 2 and (step - steps // 2) % every == 0


def nearest_photo(
    shared: Float[Tensor, " v"],
    forward: Float[Tensor, "v 3"],
    side_forward: Float[Tensor, "3"],
) -> int:
    """Training view that shares most visible points with the side view; ties by view angle.

    Args:
        shared: Points that both the side view and each training view see: how many pixels of
            the side view `sees` finds in each, or shared SfM points.
        forward: Unit view directions of the training views.
        side_forward: Unit view direction of the side view.

    Raises: ValueError if there is no training view.
    """
    if not len(shared):
        raise ValueError("no training view to choose a reference from")
    best = shared == shared.max()
    return int(torch.where(best, forward @ side_forward, -torch.inf).argmax())


def side_loss(
    render: Float[Tensor, "h w 3"],
    refined: Float[Tensor, "h w 3"],
    alpha: Float[Tensor, "h w"],
    seen_by: Float[Tensor, "h w"],
    dssim: float = 0.2,
) -> Float[Tensor, ""]:
    """L_side = l1 |I_render - I_refined|_1 + l_ssim (1 - SSIM) where real evidence is missing.

    Pixels that are solid (alpha >= 0.9) and seen by at least two training views are left to those
    views. l1 = 1 - dssim and l_ssim = dssim, as in the main loss (the paper names no values).

    Args:
        render: Render of the side view; gradients flow through it alone.
        refined: What the refiner made of the render, in [0, 1].
        alpha: Rendered opacity of each pixel, in [0, 1].
        seen_by: How many training views see each pixel's surface (`seen_by`).
        dssim: Weight l_ssim of the structural term, in [0, 1].

    Source: DPGS, Eq. 4; the mask: ours (spec).
    """
    proven = (alpha.detach() >= SOLID) & (seen_by >= EVIDENCE)
    return photometric(render, refined.detach(), dssim=dssim, mask=~proven)


def sees(view: SeenView, side: SeenView) -> Bool[Tensor, "h w"]:
    """Pixels of the side view whose surface the other view sees too: inside it and not occluded.

    A surface is seen where it lands inside the view, and the view's own rendered depth is there
    within 2 % of it. Neither view's haze (alpha below one half) is a surface.

    Args:
        view: The view that may see the surface.
        side: The view whose pixels are asked for.

    Source: ours (the z-test of the spec).
    """
    at, z = project_points(view.camera, unproject(side.camera, side.depth))
    inside = inside_image(view.camera, at) & (z > view.camera.near)
    there = sample(torch.stack([view.depth, view.alpha], dim=-1), at)
    surface = (side.alpha.reshape(-1) >= HOLE) & (there[:, 1] >= HOLE)
    agrees = (there[:, 0] - z).abs() <= OCCLUSION * z
    return (inside & surface & agrees).reshape(side.alpha.shape)


def seen_by(side: SeenView, training: Sequence[SeenView]) -> Float[Tensor, "h w"]:
    """How many training views see the surface of each pixel; 0 where there is no surface.

    Args:
        side: The view whose pixels are asked for.
        training: Training views with their rendered depths.
    """
    count = torch.zeros_like(side.alpha)
    for view in training:
        count += sees(view, side)
    return count


def warp_and_fill(side: SeenView, photo: SeenView) -> Float[Tensor, "h w 3"]:
    """The refiner without learning: reference texture through rendered depth, holes inpainted.

    A pixel takes the photo's colour where the photo sees its surface; it keeps the render where it
    has a surface that the photo does not see; holes (alpha below one half) are filled by Telea
    inpainting.

    Args:
        side: The flawed side view.
        photo: The training view that guides it.

    Source: ours, the floor that learned refiners must beat.
    """
    at, _ = project_points(photo.camera, unproject(side.camera, side.depth))
    sampled = sample(photo.image, at).reshape(side.image.shape)
    taken = sees(photo, side)[..., None]
    image = torch.where(taken, sampled.to(side.image), side.image.detach())
    return fill_holes(image, side.alpha < HOLE)


def fill_holes(image: Float[Tensor, "h w 3"], holes: Bool[Tensor, "h w"]) -> Float[Tensor, "h w 3"]:
    """Inpaint the marked pixels (8-bit inside, so they carry 1/255 steps); others are untouched.

    Args:
        image: sRGB; clamped to [0, 1] for the inpainting.
        holes: True where a pixel is to be filled.
    """
    bytes_ = (image.clamp(0, 1) * 255).round().byte().numpy()
    filled = cv2.inpaint(bytes_, holes.numpy().astype(np.uint8), 3, cv2.INPAINT_TELEA)
    return torch.where(holes[..., None], torch.from_numpy(filled).to(image) / 255, image)


def unproject(camera: Camera, depth: Float[Tensor, "h w"]) -> Float[Tensor, "n 3"]:
    """World points of a z-depth map, row-major.

    Args:
        camera: Camera that the map belongs to.
        depth: z-depth of each pixel in scene units, as large as the camera's image.

    Returns: Positions in scene units; pixels of depth 0 land on the camera centre.
    """
    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([columns + 0.5, rows + 0.5, torch.ones_like(rows)], dim=-1).reshape(-1, 3)
    cam = pixels.to(camera.K) @ torch.linalg.inv(camera.K).T * depth.reshape(-1, 1).to(camera.K)
    return (cam - camera.translation) @ camera.rotation


def inside_image(camera: Camera, at: Float[Tensor, "n 2"]) -> Bool[Tensor, " n"]:
    """Which pixel positions lie in the camera's image.

    Args:
        camera: Its size counts.
        at: Positions (x, y) in pixels; pixel centres are at .5.
    """
    size = at.new_tensor([camera.width, camera.height])
    return (at >= 0).all(dim=1) & (at < size).all(dim=1)


def sample(image: Float[Tensor, "h w c"], at: Float[Tensor, "n 2"]) -> Float[Tensor, "n c"]:
    """Bilinear values at pixel positions; border values outside.

    Args:
        image: With any number of channels.
        at: Positions (x, y) in pixels; pixel centres are at .5.
    """
    size = at.new_tensor([image.shape[1], image.shape[0]])
    place = (2 * at / size - 1)[None, :, None]
    planes = image.permute(2, 0, 1)[None].to(at)
    return functional.grid_sample(planes, place, padding_mode="border", align_corners=False)[
        0, :, :, 0
    ].T
