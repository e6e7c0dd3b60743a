"""How far colours are apart for the eye: distances in CIELAB, where equal steps look about equal."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import Pair, check_pair, mean_over


def delta_e_76(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean CIE76 colour difference: the straight distance in CIELAB under D65.

    About 2.3 is just noticeable; saturated colours are overrated, which `delta_e_2000` mends.

    Args:
        image: What is scored, sRGB in [0, 1].
        target: The truth, sRGB in [0, 1].
        mask: True where a pixel counts.
    Returns: In units of Delta E*ab, >= 0, 0 for equal images; nan where no pixel counts.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: CIE 15:2004, Eq. 8.21; CIELAB by kornia.color.rgb_to_lab.
    """
    pair = check_pair(image, target, mask, metric="delta_e_76")
    return mean_over(delta_e_76_map(pair), pair.valid)


def delta_e_2000(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Mean CIEDE2000 colour difference, with unit weights of lightness, chroma and hue.

    About 1 is just noticeable. CIELAB comes from kornia, the difference from scikit-image: kornia
    has none.

    Args:
        image: What is scored, sRGB in [0, 1].
        target: The truth, sRGB in [0, 1].
        mask: True where a pixel counts.
    Returns: In units of Delta E 00, >= 0, 0 for equal images; nan where no pixel counts.
    Raises: DataError, see metrics.pairs.check_pair.
    Source: Sharma, Wu and Dalal 2005, "The CIEDE2000 color-difference formula", Eq. 2 to 22.
    """
    pair = check_pair(image, target, mask, metric="delta_e_2000")
    return mean_over(delta_e_2000_map(pair), pair.valid)


def delta_e_76_map(pair: Pair) -> Float[np.ndarray, "h w"]:
    """The CIE76 difference at each pixel.

    Source: CIE 15:2004, Eq. 8.21.
    """
    return np.linalg.norm(_lab(pair.image) - _lab(pair.target), axis=2)


def delta_e_2000_map(pair: Pair) -> Float[np.ndarray, "h w"]:
    """The CIEDE2000 difference at each pixel.

    Source: Sharma, Wu and Dalal 2005, as skimage.color.deltaE_ciede2000 computes it.
    """
    from skimage.color import deltaE_ciede2000  # slow to import, needed here alone

    return np.asarray(deltaE_ciede2000(_lab(pair.target), _lab(pair.image)))


def _lab(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """CIELAB (L in [0, 100], a, b) of sRGB, white D65, the CIE's 2 degree observer."""
    from kornia.color import rgb_to_lab  # slow to import, needed here alone

    return rgb_to_lab(torch.from_numpy(image).permute(2, 0, 1)).permute(1, 2, 0).numpy()
