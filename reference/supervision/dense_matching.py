"""Dense matching of two images: the interface, and the default that needs no download."""

from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

TEXTURE = 2.0
"""Local standard deviation (of 255) at which a pixel's certainty is halved for lack of texture."""
PATCH_STRIDE = 2
"""Pixels between patches. 2 instead of the preset's 4 takes the share of matches on the courtyard whose
depth is off by more than 5 % from 14 to 8 %; 1 takes it to 6 % in twice the time."""
LEAST_SIDES = (8, 12)
"""Shorter and longer side in pixels below which OpenCV's flow refuses an image."""
AGREEMENT = 1.0
"""Forward-backward distance in pixels at which certainty falls to exp(-1/2)."""


@runtime_checkable
class DenseMatcher(Protocol):
    """Anything that says for every pixel of image A where it lies in image B, and how surely."""

    def __call__(
        self, image_a: Float[Tensor, "h w 3"], image_b: Float[Tensor, "hb wb 3"]
    ) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
        """Return the warp W with u_B = u_A + W(u_A) in pixels, and certainty in [0, 1]."""
        ...


def match_by_flow(
    image_a: Float[Tensor, "h w 3"],
    image_b: Float[Tensor, "hb wb 3"],
    plane: Float[Tensor, "3 3"] | None = None,
) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
    """Dense inverse search optical flow both ways; sure where they agree and texture is there.

    Flow finds small motions only. Aerial photos of one flight differ by half an image and a turn,
    but see about the same plane: given its homography, image B is first brought into A's frame,
    and flow finds what is left.

    Certainty = exp(-|forward + backward|^2 / 2) * v / (v + 4), v the local variance over 9 x 9
    pixels in squared 8-bit steps: a flat patch proves nothing. It is 0 where B does not reach, and
    everywhere on images below LEAST_SIDES.

    Args:
        image_a: The image that is matched at every pixel, sRGB in [0, 1].
        image_b: The other image, sRGB in [0, 1]; as large as image_a, or of any size with a plane.
        plane: Homography from pixels of A to pixels of B (centres at .5); None: the identity.

    Source: flow: Kroeger et al. 2016, "Fast Optical Flow using Dense Inverse Search" (OpenCV);
        homography and certainty: ours.
    """
    height, width, _ = image_a.shape
    if min(height, width) < LEAST_SIDES[0] or max(height, width) < LEAST_SIDES[1]:
        return torch.zeros(height, width, 2), torch.zeros(height, width)
    gray_a, gray_b = _gray(image_a), _gray(image_b)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.stack([columns, rows], axis=-1)
    shared = np.ones((height, width), bool)
    if plane is not None:
        at = _through(plane.numpy(), centres)
        shared = ((at >= 0) & (at < [image_b.shape[1], image_b.shape[0]])).all(axis=-1)
        gray_b = _read(gray_b, at)
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    # the preset stops at half the resolution, where depth errors are three times as large
    search.setFinestScale(0)
    search.setPatchStride(PATCH_STRIDE)
    # cv2's own stub asks for a flow to start from; cv2 takes None
    forward = search.calc(gray_a, gray_b, None)  # pyrefly: ignore[no-matching-overload]
    backward = search.calc(gray_b, gray_a, None)  # pyrefly: ignore[no-matching-overload]
    landed = centres + forward
    returned = forward + _read(backward, landed)
    agreement = np.exp(-np.square(returned).sum(axis=-1) / (2 * AGREEMENT**2))
    level = gray_a.astype(np.float32)
    variance = cv2.blur(level * level, (9, 9)) - cv2.blur(level, (9, 9)) ** 2
    texture = np.clip(variance, 0, None)
    certainty = agreement * texture / (texture + TEXTURE**2) * shared
    target = landed if plane is None else _through(plane.numpy(), landed)
    warp = (target - centres).astype(np.float32)
    return torch.from_numpy(warp), torch.from_numpy(certainty.astype(np.float32))


def plane_between(
    pixels_a: Float[Tensor, "n 2"], pixels_b: Float[Tensor, "n 2"]
) -> Float[Tensor, "3 3"] | None:
    """Homography from A to B through shared points, by least median; None with fewer than 8.

    Args:
        pixels_a: Pixel positions (x, y) of the shared points in image A, centres at .5.
        pixels_b: Pixel positions (x, y) of the same points in image B.
    """
    if len(pixels_a) < 8:
        return None
    found, _ = cv2.findHomography(
        pixels_a.double().numpy(), pixels_b.double().numpy(), method=cv2.LMEDS
    )
    return None if found is None else torch.from_numpy(found)


def _gray(image: Float[Tensor, "h w 3"]) -> np.ndarray:
    return cv2.cvtColor((image.clamp(0, 1) * 255).round().byte().numpy(), cv2.COLOR_RGB2GRAY)


def _through(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of shape [h, w, 2] through a homography."""
    return cv2.perspectiveTransform(points.reshape(-1, 1, 2).astype(np.float64), plane).reshape(
        points.shape
    )


def _read(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Bilinear values at pixel positions; OpenCV counts from the centre of the first pixel."""
    x, y = (at[..., i].astype(np.float32) - np.float32(0.5) for i in (0, 1))
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
