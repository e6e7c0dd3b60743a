"""HVI colour space: intensity, and hue on a circle that shrinks to a point in the dark."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

COLLAPSE = 0.2
"""Exponent k of the intensity collapse at which training starts."""
EPSILON = 1e-8


def to_hvi(
    image: Float[Tensor, "*n 3"], collapse: float | Float[Tensor, ""] = COLLAPSE
) -> Float[Tensor, "*n 3"]:
    """(H, V, I): I = max(R, G, B), (H, V) = C S (cos, sin)(2 pi h), C = (sin(pi I / 2) + 1e-8)^k.

    Grey and black have no hue: S = 0 there, and no gradient flows through the hue.

    Args:
        image: sRGB in [0, 1].
        collapse: k > 0; a tensor where it is learnt.

    Returns: H and V in [-1, 1], I in [0, 1].

    Source: Yan et al. 2025, "HVI: A New Color Space for Low-light Image Enhancement", Sec. 3.
    """
    high, low = image.amax(dim=-1), image.amin(dim=-1)
    red, green, blue = image.unbind(dim=-1)
    spread = high - low
    coloured = spread > 0
    safe = torch.where(coloured, spread, 1)
    sextant = torch.where(
        high == red,
        (green - blue) / safe,
        torch.where(high == green, 2 + (blue - red) / safe, 4 + (red - green) / safe),
    )
    angle = torch.where(coloured, sextant, 0) * (2 * math.pi / 6)
    saturation = torch.where(coloured, spread / (high + EPSILON), 0)
    radius = saturation * (torch.sin(math.pi * high / 2) + EPSILON) ** collapse
    return torch.stack([radius * angle.cos(), radius * angle.sin(), high], dim=-1)


def descriptor(image: Float[Tensor, "*n 3"]) -> Float[Tensor, "12"]:
    """What a view's light is like: mean, spread and the 10 and 90 % quantiles of H, V and I.

    Twelve numbers, in the order H, V, I within each statistic. The paper leaves f_HVI open; a
    learnt layer on top of these fixed statistics is enough to tell lights apart (our choice).

    Args:
        image: The view's image or those of its pixels that count, sRGB in [0, 1].

    Source: DLG-GS, Eq. 7; statistics: ours.
    """
    return statistics(to_hvi(image).reshape(-1, 3))


def statistics(pixels: Float[Tensor, "n 3"]) -> Float[Tensor, "12"]:
    """Mean, spread and the 10 and 90 % quantiles of each channel, the channels within each.

    Args:
        pixels: At least one, in any colour space.

    Source: ours.
    """
    # By columns: torch's quantile takes no more than 2^24 numbers at once.
    ends = torch.stack([_quantiles(column) for column in pixels.T], dim=1)
    spread = pixels.std(dim=0, correction=0)
    return torch.cat([pixels.mean(dim=0), spread, ends[0], ends[1]])


def _quantiles(values: Float[Tensor, " n"]) -> Float[Tensor, "2"]:
    """The 10 and 90 % quantiles, linear between the two nearest values."""
    ordered = values.sort().values
    places = values.new_tensor([0.1, 0.9], dtype=torch.float64) * (len(values) - 1)
    low = places.floor().long()
    high = (low + 1).clamp(max=len(values) - 1)
    return torch.lerp(ordered[low], ordered[high], (places - low).to(values))


def illumination_factor(
    image: Float[Tensor, "h w 3"], weights: Float[Tensor, "12 e"]
) -> Float[Tensor, " e"]:
    """eps_s = tanh(f_HVI(I)): the view's adjustment factor, in (-1, 1).

    Args:
        image: The view's image, sRGB in [0, 1].
        weights: Learnt linear layer of f_HVI, from the 12 statistics of `descriptor` to e numbers.

    Source: DLG-GS, Eq. 7.
    """
    return torch.tanh(descriptor(image).to(weights) @ weights)
