"""Front-to-back compositing of sorted contributions."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.rasterizer.projection import ALPHA_MIN

ALPHA_MAX = 0.99
"""No single contribution is more opaque than this."""
T_MIN = 1e-4
"""A pixel stops before the contribution that would take its transmittance below this."""


def alphas(
    offsets: Float[Tensor, "p n 2"],
    conics: Float[Tensor, "n 2 2"],
    opacities: Float[Tensor, " n"],
) -> Float[Tensor, "p n"]:
    """Opacity of each Gaussian at each pixel: min(0.99, o exp(-d^T Sigma2^-1 d / 2)), 0 if < 1/255.

    Args:
        offsets: d, pixel centre minus mean, in pixels.
        conics: Sigma2^-1 in 1 / squared pixels, positive definite.
        opacities: Opacity o of each Gaussian, in [0, 1].

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 4 and its release's thresholds.
    """
    power = -0.5 * torch.einsum("pni,nij,pnj->pn", offsets, conics, offsets)
    alpha = (opacities * power.exp()).clamp(max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0)


def weights(
    alpha: Float[Tensor, "p n"],
) -> tuple[Float[Tensor, "p n"], Float[Tensor, " p"]]:
    """Compositing weights w_i = a_i prod_{j<i} (1 - a_j), and the light that is left.

    Args:
        alpha: Opacities at each pixel, nearest first.

    Returns: The weights, 0 from the contribution on that would take transmittance below 1e-4;
        and the final transmittance in [1e-4, 1].

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 3.
    """
    after = (1 - alpha).cumprod(dim=1)
    alpha = torch.where(after >= T_MIN, alpha, 0)  # `after` falls, so what is kept is a prefix
    after = (1 - alpha).cumprod(dim=1)
    before = torch.cat([alpha.new_ones(len(alpha), 1), after], dim=1)
    return alpha * before[:, :-1], before[:, -1]
