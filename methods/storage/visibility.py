"""How much of the photos each Gaussian is: its blending weights, summed over views."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.backends import get_backend
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View

PROBES = 3
"""Random signs a view by which squared weights are estimated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """Sums over the pixels of all views."""

    weights: Float[Tensor, " n"]
    """W_1 = sum w_i: pixels that a Gaussian is worth."""
    squares: Float[Tensor, " n"]
    """An estimate of W_2 = sum w_i^2: what an error of its colour costs."""


def visibility(
    model: Gaussians,
    views: Sequence[View],
    *,
    generator: torch.Generator,
    mode: Mode = "classic",
    backend: str = "cpu",
) -> Visibility:
    """Blending weights of each Gaussian, from gradients of the image by its colour.

    An image is linear in the colours: of C = sum_i w_i c_i the sum over pixels has the gradient W_1
    by c_i. With a random sign at each pixel the square of the gradient is W_2 on average.

    Args:
        model: The Gaussians.
        views: Views that are looked from; their cameras suffice.
        generator: Draws the signs.
        mode: How the model is rasterized.
        backend: Name of the rasterizer.

    Source: ours; the estimate of a diagonal by random signs: Hutchinson 1990, "A stochastic estimator
        of the trace of the influence matrix".
    """
    rasterize = get_backend(backend).rasterize
    weights, squares = torch.zeros(len(model)), torch.zeros(len(model))
    scales, opacities = model.log_scales.exp(), model.opacity_logits.sigmoid()
    for view in views:
        colours = torch.ones(len(model), 1 + PROBES, requires_grad=True)
        out = rasterize(
            view.camera,
            model.means,
            model.quaternions,
            scales,
            opacities,
            colours=colours,
            mode=mode,
        )
        signs = torch.randint(0, 2, out.colour.shape, generator=generator) * 2.0 - 1
        signs[..., 0] = 1
        (gradient,) = torch.autograd.grad((out.colour * signs).sum(), colours)
        weights += gradient[:, 0]
        squares += gradient[:, 1:].square().mean(dim=1)
    return Visibility(weights=weights, squares=squares)
