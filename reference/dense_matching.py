"""Dense matching of two images: the interface, and the default that needs no download."""

from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

TEXTURE = 2.0
"""Local standard deviation (of 255) at which a pixel's certainty is halved for lack of texture."""
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
    image_a: Float[Tensor, "h w 3"], image_b: Float[Tensor, "h w 3"]
) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
    """Dense inverse search optical flow both ways; sure where they agree and texture is there.

    Images must have the same size. Certainty = exp(-|forward + backward|^2 / 2) * v / (v + 4),
    v the local variance over 9 x 9 pixels in squared 8-bit steps: a flat patch proves nothing.

    Source: flow: Kroeger et al. 2016, "Fast Optical Flow using Dense Inverse Search" (OpenCV);
        certainty: ours.
    """
    gray_a, gray_b = (
        cv2.cvtColor((image.clamp(0, 1) * 255).round().byte().numpy(), cv2.COLOR_RGB2GRAY)
        for image in (image_a, image_b)
    )
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    forward = search.calc(gray_a, gray_b, None)  # type: ignore[call-overload]
    backward = search.calc(gray_b, gray_a, None)  # type: ignore[call-overload]
    height, width = gray_a.shape
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    lands = (
        (columns + forward[..., 0]).astype(np.float32),
        (rows + forward[..., 1]).astype(np.float32),
    )
    returned = forward + cv2.remap(
        backward, *lands, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    agreement = np.exp(-np.square(returned).sum(axis=-1) / (2 * AGREEMENT**2))
    level = gray_a.astype(np.float32)
    variance = cv2.blur(level * level, (9, 9)) - cv2.blur(level, (9, 9)) ** 2
    texture = np.clip(variance, 0, None)
    certainty = agreement * texture / (texture + TEXTURE**2)
    return torch.from_numpy(forward), torch.from_numpy(certainty.astype(np.float32))
