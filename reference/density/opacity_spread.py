"""How far pixels disagree about a Gaussian's opacity: one that stands for several surfaces is worth growing."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.rasterizer import compositing, projection, rotation, spherical_harmonics
from splatproof.reference.rasterizer.screen_gradient import pixel_offsets
from splatproof.reference.types.camera import Camera


@torch.enable_grad()
def fragment_gradients(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    sh: Float[Tensor, "n k 3"],
    by_colour: Float[Tensor, "h w 3"],
) -> tuple[Float[Tensor, "p n"], Bool[Tensor, "p n"]]:
    """Gradient g = dL / d ln(alpha) of each fragment of a picture over black, and which there are.

    Args:
        camera: Where the picture is taken from.
        means: Positions in scene units, as all that follows as `rasterize` takes it.
        quaternions: Rotations (w, x, y, z).
        scales: Standard deviations in scene units.
        opacities: Opacities in [0, 1].
        sh: Spherical-harmonic coefficients.
        by_colour: dL / d colour of each pixel.

    Returns: g of each pixel, row by row, and Gaussian: 0 where it is not drawn, and where alpha is clamped; and
        where it is drawn.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 3.
    """
    flat = projection.project(camera, means, rotation.half_covariance(quaternions, scales))
    order = torch.where(flat.in_front)[0]
    order = order[torch.sort(flat.depths[order], stable=True).indices]
    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(means) + 0.5
    offsets = pixel_offsets(pixels, flat.means, None)[:, order]
    alphas = compositing.alphas(offsets, flat.conics[order], opacities[order])
    alphas = alphas.detach().requires_grad_()
    weights, _ = compositing.weights(alphas)
    colours = spherical_harmonics.seen_colours(means, camera.centre, sh, None)[order]
    (by_alpha,) = torch.autograd.grad(weights @ colours, alphas, by_colour.reshape(-1, 3))
    own = (alphas * by_alpha).where(alphas < compositing.ALPHA_MAX, 0).detach()
    gradients = own.new_zeros(len(pixels), len(means))
    drawn = torch.zeros_like(gradients, dtype=torch.bool)
    gradients[:, order], drawn[:, order] = own, weights > 0
    return gradients, drawn


def tallied(gradients: Float[Tensor, "p n"], drawn: Bool[Tensor, "p n"]) -> Float[Tensor, "n 3"]:
    """What the fragments of one view say of each Gaussian: sum of g, sum of g^2, and their number.

    A fragment is a Gaussian at a pixel that it is drawn on, and g = o dL / do = dL / d ln(alpha) there, without
    the gradient that a clamped alpha does not pass on. Tallies of several views add up.

    Args:
        gradients: g of each pixel and Gaussian; 0 where it is not drawn.
        drawn: Where it is.

    Source: MooreThreads, "LiteGS", its release. There each sum of squares is of running sums along the
        pixels of a thread; here each fragment's gradient is squared.
    """
    return torch.stack(
        [gradients.sum(dim=0), gradients.square().sum(dim=0), drawn.sum(dim=0).to(gradients)], 1
    )


def spread(tallies: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Score n max(0, Q / (n + 1) - (G / (n + 1))^2), with G, Q and n of `tallied` over all views looked at.

    That is Var(dL / do) n o^2: the mean gradient vanishes where some pixels want a Gaussian more opaque and
    others less, and its variance is largest there. Never negative, 0 where nothing is drawn.

    Args:
        tallies: G, Q and n of each Gaussian.

    Source: MooreThreads, "LiteGS", its release; o^2 is within the gradients here, and those of several steps
        count with the opacity that each was taken at.
    """
    total, squares, count = tallies.double().unbind(dim=1)
    variance = squares / (count + 1) - (total / (count + 1)).square()
    return (count * variance.clamp(min=0)).to(tallies)
