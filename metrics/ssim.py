"""Structural similarity in the variants that papers use, each under its own name.

They differ by up to 0.02 on one and the same pair, so a number without its variant says little.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import Pair, check_pair, mean_over

WINDOW = 11
"""Side of the Gaussian window in pixels (Wang et al. 2004)."""
SIGMA = 1.5
"""Standard deviation of the Gaussian window in pixels."""
C1 = 0.01**2
C2 = 0.03**2
"""Stabilisers (k L)^2 for the data range L = 1."""
UNIFORM_WINDOW = 7
"""Side of scikit-image's default window."""
SCALES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Standard deviations of the multi-scale Gaussians in pixels, widest last."""
SCALES_WINDOW = 33
"""Side of the multi-scale windows in pixels: 2 sigma of the widest to each side."""


def ssim_3dgs(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """SSIM as 3DGS and its descendants report it: 11x11 Gaussian, zeros beyond the border.

    Args:
        image: What is scored, in [0, 1], both sides at least 11.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over pixels whose window, as far as it
            lies inside the image, is fully valid.
    Returns: Mean over pixels and channels, in [-1, 1], 1 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Wang et al. 2004, Eq. 13, with the padding of the 3DGS release (utils/loss_utils.py).
    """
    pair = check_pair(image, target, mask, window=WINDOW, metric="ssim_3dgs")
    counted = windows_valid(pair.valid, WINDOW, beyond_border=True)
    return mean_over(ssim_map(pair.image, pair.target), counted)


def ssim_valid(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """SSIM over the 11x11 Gaussian windows that lie inside the image, as its authors define it.

    Args:
        image: What is scored, in [0, 1], both sides at least 11.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over windows that are fully valid.
    Returns: Mean over windows and channels, in [-1, 1], 1 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Wang et al. 2004, "Image quality assessment", Eq. 13.
    """
    pair = check_pair(image, target, mask, window=WINDOW, metric="ssim_valid")
    counted = windows_valid(pair.valid, WINDOW, beyond_border=False)
    return mean_over(ssim_map(pair.image, pair.target), counted)


def ssim_skimage(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """scikit-image's structural_similarity(image, target, data_range=1, channel_axis=-1).

    All else is its default: 7x7 uniform window, sample covariance (n - 1), borders cropped.

    Args:
        image: What is scored, in [0, 1], both sides at least 7.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over windows that are fully valid.
    Returns: Mean over windows and channels, in [-1, 1], 1 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: scikit-image, skimage.metrics.structural_similarity.
    """
    pair = check_pair(image, target, mask, window=UNIFORM_WINDOW, metric="ssim_skimage")
    counted = windows_valid(pair.valid, UNIFORM_WINDOW, beyond_border=False)
    return mean_over(skimage_map(pair), counted)


def skimage_map(pair: Pair) -> Float[np.ndarray, "h w 3"]:
    """scikit-image's SSIM at each pixel and channel, with reflected borders."""
    from skimage.metrics import structural_similarity  # slow to import, needed here alone

    full = structural_similarity(
        pair.image, pair.target, data_range=1.0, channel_axis=-1, full=True
    )[1]
    return np.asarray(full)


def ssim_kornia(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean of kornia.metrics.ssim(image, target, 11, eps=0): 11x11 Gaussian, borders mirrored.

    Its default eps of 1e-12 would take up to 1.1e-5 off where both images are black. In float64,
    about 4 us a pixel on one core.

    Args:
        image: What is scored, in [0, 1], both sides at least 11.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over pixels whose window, as far as it
            lies inside the image, is fully valid.
    Returns: Mean over pixels and channels, in [-1, 1], 1 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Wang et al. 2004, Eq. 13, as kornia.metrics.ssim has it.
    """
    pair = check_pair(image, target, mask, window=WINDOW, metric="ssim_kornia")
    counted = windows_valid(pair.valid, WINDOW, beyond_border=True)
    return mean_over(kornia_map(pair), counted)


def kornia_map(pair: Pair) -> Float[np.ndarray, "h w 3"]:
    """kornia's SSIM at each pixel and channel, with mirrored borders."""
    from kornia.metrics import ssim  # slow to import, needed here alone

    first, second = (
        torch.from_numpy(image).permute(2, 0, 1)[None] for image in (pair.image, pair.target)
    )
    return ssim(first, second, WINDOW, eps=0.0)[0].permute(1, 2, 0).numpy()


def ms_ssim_kornia(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Multi-scale SSIM as kornia defines it: five Gaussians at full size, no pyramid of halves.

    l(widest) prod_s cs(s) with sigma s = 0.5, 1, 2, 4, 8 px, all 33 px wide, zeros beyond the
    border. Other libraries' MS-SSIM is the pyramid of Wang et al. 2003: another metric. Computed
    here with separable filters, since kornia's dense ones take minutes on a 1000 px image.

    Args:
        image: What is scored, in [0, 1], both sides at least 33.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over pixels whose 33x33 window, as far
            as it lies inside the image, is fully valid.
    Returns: Mean over pixels and channels, in [-1, 1], 1 for equal images; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Zhao et al. 2017, "Loss functions for image restoration", Sec. III-C; the numbers of
        1 - kornia.losses.MS_SSIMLoss(alpha=1, compensation=1).
    """
    pair = check_pair(image, target, mask, window=SCALES_WINDOW, metric="ms_ssim_kornia")
    similarity = np.ones_like(pair.image)
    for sigma in SCALES:
        luminance, structure = similarity_terms(pair.image, pair.target, SCALES_WINDOW, sigma)
        similarity *= structure * (luminance if sigma == SCALES[-1] else 1)
    return mean_over(similarity, windows_valid(pair.valid, SCALES_WINDOW, beyond_border=True))


def ssim_contrast(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """The contrast term of SSIM alone: whether there is as much detail as in the truth, wherever it stands.

    A smear has too little of it, noise too much. PSNR, SSIM and FLIP ask where each leaf stands, and so
    prefer a smear to leaves that stand elsewhere; this one does not ask at all: read it beside them.

    Args:
        image: What is scored, in [0, 1], both sides at least 11.
        target: The truth, in [0, 1].
        mask: True where a pixel counts; the mean is then over windows that are fully valid.
    Returns: Mean over windows and channels, in [0, 1], 1 for equal local contrasts; nan without a window.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Wang et al. 2004, Eq. 9, c(x, y), over the windows of `ssim_valid`.
    """
    pair = check_pair(image, target, mask, window=WINDOW, metric="ssim_contrast")
    counted = windows_valid(pair.valid, WINDOW, beyond_border=False)
    return mean_over(contrast_map(pair.image, pair.target), counted)


def contrast_map(
    image: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w 3"]:
    """c = (2 sx sy + C2) / (sx^2 + sy^2 + C2) at each pixel and channel under the 11x11 Gaussian.

    Args:
        image: What is scored, in [0, 1]; float64, since E[x^2] - E[x]^2 cancels.
        target: The truth, in [0, 1]; float64.
    """
    sx, sy = (
        np.maximum(blurred(values * values) - blurred(values) ** 2, 0) for values in (image, target)
    )
    return (2 * np.sqrt(sx * sy) + C2) / (sx + sy + C2)


def blurred(
    values: Float[np.ndarray, "h w 3"], window: int = WINDOW, sigma: float = SIGMA
) -> Float[np.ndarray, "h w 3"]:
    """Gaussian mean about each pixel, zeros beyond the border.

    Args:
        values: One for each pixel and channel.
        window: Side of the window in pixels.
        sigma: Standard deviation in pixels.
    """
    # OpenCV's constant border is zero and its kernel the normalised, truncated Gaussian.
    return cv2.GaussianBlur(values, (window, window), sigma, borderType=cv2.BORDER_CONSTANT)


def ssim_map(
    image: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w 3"]:
    """SSIM at each pixel and channel under the 11x11 Gaussian: luminance times structure.

    Args:
        image: What is scored, in [0, 1]; float64, since E[x^2] - E[x]^2 cancels.
        target: The truth, in [0, 1]; float64.
    """
    luminance, structure = similarity_terms(image, target, WINDOW, SIGMA)
    return luminance * structure


def similarity_terms(
    x: Float[np.ndarray, "h w 3"], y: Float[np.ndarray, "h w 3"], window: int, sigma: float
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]]:
    """l = (2 mx my + C1) / (mx^2 + my^2 + C1) and cs = (2 sxy + C2) / (sx^2 + sy^2 + C2).

    Args:
        x: One image, in [0, 1]; float64, since E[x^2] - E[x]^2 cancels.
        y: The other image, in [0, 1]; float64.
        window: Side in pixels of the Gaussian that weighs the moments; zeros beyond the border.
        sigma: Standard deviation of that Gaussian in pixels.
    Returns: l and cs at each pixel and channel.
    """

    def blur(values: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
        return blurred(values, window, sigma)

    mx, my = blur(x), blur(y)
    sx, sy, sxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    luminance = (2 * mx * my + C1) / (mx * mx + my * my + C1)
    return luminance, (2 * sxy + C2) / (sx + sy + C2)


def windows_valid(
    valid: Bool[np.ndarray, "h w"], window: int, *, beyond_border: bool
) -> Bool[np.ndarray, "h w"]:
    """Where all pixels of the window about a pixel are valid.

    Args:
        valid: True where a pixel counts.
        window: Side of the window in pixels, odd.
        beyond_border: Whether what lies outside the image counts as valid.
    """
    kernel = np.ones((window, window), dtype=np.uint8)
    eroded = cv2.erode(
        valid.astype(np.uint8),
        kernel,
        borderType=cv2.BORDER_CONSTANT,
        borderValue=(int(beyond_border),),
    )
    return eroded.astype(bool)
