"""The photometric loss of 3D Gaussian Splatting: L1 and the structural dissimilarity."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

WINDOW = 11
"""Side of the SSIM window in pixels."""
SIGMA = 1.5
"""Standard deviation of the SSIM window in pixels."""
C1 = 0.01**2
C2 = 0.03**2


def window(like: Tensor) -> Float[Tensor, " 11"]:
    """Weights of the separable Gaussian window, summing to 1, in the dtype of `like`."""
    x = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weight = (-(x**2) / (2 * SIGMA**2)).exp()
    return (weight / weight.sum()).to(like)


def blur(image: Float[Tensor, "h w c"]) -> Float[Tensor, "h w c"]:
    """Each channel convolved with the SSIM window; what lies outside the image counts as zero."""
    weight = window(image)
    planes = image.permute(2, 0, 1)[:, None]
    planes = functional.conv2d(planes, weight.view(1, 1, 1, -1), padding=(0, WINDOW // 2))
    planes = functional.conv2d(planes, weight.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))
    return planes[:, 0].permute(1, 2, 0)


def ssim_map(
    image: Float[Tensor, "h w c"], truth: Float[Tensor, "h w c"]
) -> Float[Tensor, "h w c"]:
    """SSIM around every pixel, (2 mu_a mu_b + C1)(2 s_ab + C2) / ((mu_a^2 + mu_b^2 + C1)(...)).

    Args:
        image: Render, data range 1.
        truth: Photo, data range 1.

    Returns: Values in [-1, 1]; 1 where the two agree.

    Source: Wang et al. 2004, "Image quality assessment", Eq. 13; window, zero padding and data
        range 1 of the 3DGS release (a window that leaves the image sees black in both).
    """
    mean_a, mean_b = blur(image), blur(truth)
    variance_a = blur(image * image) - mean_a**2
    variance_b = blur(truth * truth) - mean_b**2
    covariance = blur(image * truth) - mean_a * mean_b
    top = (2 * mean_a * mean_b + C1) * (2 * covariance + C2)
    return top / ((mean_a**2 + mean_b**2 + C1) * (variance_a + variance_b + C2))


def photometric(
    image: Float[Tensor, "h w c"],
    truth: Float[Tensor, "h w c"],
    *,
    dssim: float = 0.2,
    mask: Bool[Tensor, "h w"] | None = None,
) -> Float[Tensor, ""]:
    """Training loss (1 - l) mean|image - truth| + l (1 - mean SSIM), over valid pixels.

    Args:
        image: Render; not clamped.
        truth: Photo in [0, 1].
        dssim: Weight l in [0, 1].
        mask: True where the photo is valid; None: all. Invalid pixels are black in both images, as
            what lies outside them, so they pull on nothing, not even through the SSIM window.

    Returns: The loss; 0 where no pixel is valid.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 7; masks: ours.
    """
    if mask is None:
        return (1 - dssim) * (image - truth).abs().mean() + dssim * (
            1 - ssim_map(image, truth).mean()
        )
    valid = mask[..., None]
    image, truth = torch.where(valid, image, 0), torch.where(valid, truth, 0)
    count = (mask.sum() * image.shape[2]).clamp(min=1)
    difference = (image - truth).abs().sum() / count
    dissimilarity = torch.where(valid, 1 - ssim_map(image, truth), 0).sum() / count
    return (1 - dssim) * difference + dssim * dissimilarity
