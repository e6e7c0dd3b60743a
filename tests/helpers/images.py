"""Images for tests of metrics: drawn, photographed, and spoiled by a known amount."""

import cv2
import numpy as np
import torch
from hypothesis import strategies as st
from jaxtyping import Bool, Float
from skimage import data
from torch import Tensor


def noise_image(height: int, width: int, seed: int) -> Float[Tensor, "h w 3"]:
    """Uniform noise in [0, 1]: the hardest case for filters."""
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def spoiled(
    image: Float[Tensor, "h w 3"], sigma: float, seed: int = 1, blur: float = 0.0
) -> Float[Tensor, "h w 3"]:
    """The image blurred (sigma in pixels) and with Gaussian noise, clipped to [0, 1]."""
    soft = image.numpy()
    if blur:
        soft = cv2.GaussianBlur(soft, (0, 0), blur)
    noise = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))
    return (torch.from_numpy(soft) + sigma * noise).clamp(0, 1)


def photo() -> Float[Tensor, "400 600 3"]:
    """scikit-image's photo of a cup of coffee."""
    return torch.from_numpy(data.coffee().astype(np.float32) / 255)


def random_mask(height: int, width: int, share: float, seed: int) -> Bool[Tensor, "h w"]:
    """About `share` of the pixels valid, in blobs so that whole windows can be."""
    values = noise_image(height, width, seed).mean(dim=2).numpy()
    smooth = cv2.GaussianBlur(values, (0, 0), 4.0)
    return torch.from_numpy(smooth <= np.quantile(smooth, share))


@st.composite
def pairs(draw: st.DrawFn, smallest: int = 1, largest: int = 40):
    """(image, target): noise, the target near or far, sometimes equal, sometimes constant."""
    height, width = (draw(st.integers(smallest, largest)) for _ in range(2))
    seed = draw(st.integers(0, 2**16))
    target = noise_image(height, width, seed)
    if draw(st.booleans()):
        target = target[:1, :1].expand(height, width, 3).clone()
    return spoiled(target, draw(st.sampled_from([0.0, 0.01, 0.3])), seed + 1), target
