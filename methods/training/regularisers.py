"""What keeps Gaussians from explaining single photos: some are hidden at random, none is opaque for free."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

HIDDEN = -20.0
"""Opacity logit of what is hidden: below every alpha threshold."""
OPAQUEST = 0.999
"""Nothing is made up for beyond this opacity."""
FAINTEST = 1e-12
"""Opacities below are as good as none; their logarithm stays finite."""


def draw_shown(count: int, share: float, generator: torch.Generator) -> Bool[Tensor, " n"]:
    """Which Gaussians take part in a step: each is hidden with probability `share`.

    Args:
        count: Number of Gaussians.
        share: Probability of being hidden, in [0, 1).
        generator: Source of the draw.
    """
    return torch.rand(count, generator=generator) >= share


def thinned(
    logits: Float[Tensor, " n"], shown: Bool[Tensor, " n"], share: float
) -> Float[Tensor, " n"]:
    """Opacity logits of a step that shows a part: logit(o / (1 - share)) where shown, else hidden.

    Opacities o of those shown grow by what the hidden ones leave away, so that the mean over draws is
    o where o <= (1 - share) 0.999. Differentiable; 0 for what is hidden or at the cap.

    Args:
        logits: Opacity logits of all Gaussians.
        shown: Which Gaussians take part.
        share: Probability with which each was hidden, in [0, 1).

    Source: Park et al. 2025, "DropGaussian", Eq. 6; the cap is ours.
    """
    opacities = (torch.sigmoid(logits) / (1 - share)).clamp(FAINTEST, OPAQUEST)
    return torch.where(shown, torch.logit(opacities), HIDDEN)


def opacity_pull(logits: Float[Tensor, " n"], weight: float) -> Float[Tensor, " n"]:
    """Gradient of weight * mean(opacity) by the logits.

    Args:
        logits: Opacity logits of all Gaussians, at least one.
        weight: Factor on the mean, >= 0.

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Eq. 12 (there
        with weight 0.01).
    """
    opacities = torch.sigmoid(logits)
    return opacities * (1 - opacities) * (weight / len(logits))


def scale_pull(log_scales: Float[Tensor, "n 3"], weight: float) -> Float[Tensor, "n 3"]:
    """Gradient of weight * mean(scale) by the log scales.

    Args:
        log_scales: Logarithms of the scales of all Gaussians, at least one.
        weight: Factor on the mean over Gaussians and axes, >= 0.

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Eq. 12.
    """
    return log_scales.exp() * (weight / log_scales.numel())


def volume_pull(log_scales: Float[Tensor, "n 3"], weight: float) -> Float[Tensor, "n 3"]:
    """Gradient of weight * mean(product of the scales) by the log scales: equal for the three axes.

    Args:
        log_scales: Logarithms of the scales of all Gaussians, at least one.
        weight: Factor on the mean over Gaussians, >= 0.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3 (its volume term).
    """
    volumes = log_scales.sum(dim=1, keepdim=True).exp()
    return (volumes * (weight / len(log_scales))).expand_as(log_scales)
