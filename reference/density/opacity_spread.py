"""How far pixels disagree about a Gaussian's opacity: one that stands for several surfaces is worth growing."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


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
