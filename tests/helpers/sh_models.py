"""Models with harmonics of mixed energy, for everything that gates and codes them."""

import torch

from splatproof.reference.types.gaussians import Gaussians


def model(count: int, degree: int, seed: int) -> Gaussians:
    """Random Gaussians whose harmonics have between none and a tenth of the energy of their DC."""
    g = torch.Generator().manual_seed(seed)
    rest = torch.rand(count, 1, 1, generator=g) * 0.1
    sh = torch.randn(count, (degree + 1) ** 2, 3, generator=g)
    sh[:, 1:] *= rest
    return Gaussians(
        means=1e3 * torch.randn(count, 3, generator=g),
        quaternions=torch.randn(count, 4, generator=g) * 100,
        log_scales=torch.randn(count, 3, generator=g) - 3,
        opacity_logits=3 * torch.randn(count, generator=g),
        sh=sh,
    )
