"""Lighting-adaptive appearance (DLAAM): colour head and its losses.

Which image a test view's factor comes from, the paper does not say: a protocol does, by naming a
training view (`nearest_view`) or by handing over the part of the test image that is not scored.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.supervision.losses import ssim_map
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp


def adapt_colours(
    head: Mlp,
    colours: Float[Tensor, "m 3"],
    factor: Float[Tensor, " e"],
    attended: Float[Tensor, "m v"],
) -> Float[Tensor, "m 3"]:
    """c~ = beta c + (1 - beta) alpha, (alpha, beta) = sigmoid(MLP(c, eps_s, f_out)).

    Args:
        head: Three layers; 4 outputs: alpha 3, beta 1 for all channels.
        colours: Colours c of the neural Gaussians, in [0, 1].
        factor: eps_s of the view, in (-1, 1).
        attended: f_out, the attention output, of the anchor that generated each Gaussian.

    Source: DLG-GS, Eqs. 12 and 13.
    """
    inputs = torch.cat([colours, factor.expand(len(colours), -1), attended], dim=1)
    out = torch.sigmoid(mlp.evaluate(head, inputs))
    return mix_colours(colours, out[:, :3], out[:, 3:])


def mix_colours(
    colours: Float[Tensor, "m 3"],
    reference: Float[Tensor, "m 3"],
    share: Float[Tensor, "m 1"],
) -> Float[Tensor, "m 3"]:
    """c~ = beta c + (1 - beta) alpha; beta = 1 keeps c to the bit.

    Args:
        colours: Colours c of the neural Gaussians, in [0, 1].
        reference: Colours alpha that the head predicts for the view's light, in [0, 1].
        share: Share beta of c in the mix, in [0, 1].
    """
    return share * colours + (1 - share) * reference


def colour_loss(
    adapted: Float[Tensor, "h w 3"],
    original: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "h w 3"],
    dssim: float = 0.2,
) -> Float[Tensor, ""]:
    """L_color = (1 - l) L1(I_a, I) + l (1 - SSIM(I_r, I)): the base render keeps the structure.

    Args:
        adapted: Render I_a with the adapted colours c~.
        original: Render I_r with the colours c as they are.
        truth: Photo I, sRGB in [0, 1].
        dssim: Weight l of the structural term, in [0, 1].

    Source: DLG-GS, Eq. 16.
    """
    return (1 - dssim) * (adapted - truth).abs().mean() + dssim * (
        1 - ssim_map(original, truth).mean()
    )


def volume_loss(scales: Float[Tensor, "m 3"]) -> Float[Tensor, ""]:
    """L_vol = sum of the products of the scales (a sum, as printed; Scaffold-GS takes the mean).

    Source: DLG-GS, Eq. 17.
    """
    return scales.prod(dim=1).sum()


def dropout_mask(count: int, probability: float, generator: torch.Generator) -> Bool[Tensor, " m"]:
    """Which Gaussians stay on: uniform draw > gamma.

    Args:
        count: Number of Gaussians.
        probability: gamma, the chance of each Gaussian to be off, in [0, 1).
        generator: Source of the uniform draws.

    Raises: ValueError if the probability is not in [0, 1).

    Source: DLG-GS, Eq. 18.
    """
    if not 0 <= probability < 1:
        raise ValueError(f"dropout probability must be in [0, 1): {probability}")
    return torch.rand(count, generator=generator) > probability


def dropout_loss(
    dropped: Float[Tensor, "h w 3"], full: Float[Tensor, "h w 3"], dssim: float = 0.2
) -> Float[Tensor, ""]:
    """L_ARDR = (1 - l) L1 + l (1 - SSIM) between the dropout render and the full one, detached.

    Args:
        dropped: Render without the Gaussians that `dropout_mask` turned off.
        full: Render with all Gaussians; the target, through which no gradient flows.
        dssim: Weight l of the structural term, in [0, 1].

    Source: DLG-GS, Eq. 19; the detached side: spec.
    """
    target = full.detach()
    l1 = (dropped - target).abs().mean()
    return (1 - dssim) * l1 + dssim * (1 - ssim_map(dropped, target).mean())
