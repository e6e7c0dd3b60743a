"""Merging of pairs of alike Gaussians: one of the same mass, mean, covariance and colour."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatproof.reference.rasterizer.rotation import covariance, normalise
from splatproof.reference.types.gaussians import Gaussians

FLAT = 1e-20
"""Least variance of a merged Gaussian along an axis, in squared scene units."""
CLEAR = 1e-6
"""Least distance of a merged Gaussian's opacity from 0 and 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """What a pair is as one, in float64."""

    shares: Float[Tensor, " p"]
    """Share of the first in the pair's mass, 0 to 1."""
    means: Float[Tensor, "p 3"]
    covariances: Float[Tensor, "p 3 3"]


def areas(log_scales: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Product of each Gaussian's two largest standard deviations: what it covers, seen from its side.

    Args:
        log_scales: Natural logarithms of the standard deviations.

    Source: ours.
    """
    return log_scales.double().sort(dim=1).values[:, 1:].sum(dim=1).exp()


def moments(model: Gaussians, pairs: Int64[Tensor, "p 2"], mass: Float[Tensor, " n"]) -> Moments:
    """Mass-weighted mean and covariance of pairs.

    With t = m_1 / (m_1 + m_2) and d = x_1 - x_2: x = t x_1 + (1 - t) x_2 and
    S = t S_1 + (1 - t) S_2 + t (1 - t) d d^T.

    Args:
        model: The Gaussians.
        pairs: Rows of both of each pair.
        mass: What each weighs, > 0.

    Source: Runnalls 2007, "Kullback-Leibler approach to Gaussian mixture reduction", Eq. 2-4.
    """
    i, j = pairs.unbind(dim=1)
    t = mass.double()[i] / (mass.double()[i] + mass.double()[j])
    means = model.means.double()
    near = torch.unique(pairs)
    place = torch.zeros(len(model), dtype=torch.int64)
    place[near] = torch.arange(len(near))
    spread = covariance(model.quaternions[near].double(), model.log_scales[near].double().exp())
    offset = means[i] - means[j]
    u = t[:, None, None]
    outer = offset[:, :, None] * offset[:, None, :]
    return Moments(
        shares=t,
        means=t[:, None] * means[i] + (1 - t[:, None]) * means[j],
        covariances=u * spread[place[i]] + (1 - u) * spread[place[j]] + u * (1 - u) * outer,
    )


def costs(
    model: Gaussians, pairs: Int64[Tensor, "p 2"], mass: Float[Tensor, " n"]
) -> Float[Tensor, " p"]:
    """What merging each pair costs: m_1 m_2 / (m_1 + m_2) (D + sum of squared differences of SH), >= 0.

    D = (log det S - t log det S_1 - (1 - t) log det S_2) / 2 is the mean divergence of the two from
    the one, all of the same moments. It is 0 for two that are equal.

    Args:
        model: The Gaussians.
        pairs: Rows of both of each pair.
        mass: What each weighs, > 0.

    Source: D: Runnalls 2007, Sec. 4 (its bound B, per unit of mass); beside SH, with neither opacity
        nor mass: NanoGS (arXiv 2603.16103); the whole: ours.
    """
    i, j = pairs.unbind(dim=1)
    found = moments(model, pairs, mass)
    volume = 2 * model.log_scales.double().sum(dim=1)
    t = found.shares
    apart = torch.logdet(found.covariances) - t * volume[i] - (1 - t) * volume[j]
    colour = (model.sh[i] - model.sh[j]).double().square().sum(dim=(1, 2))
    weight = mass.double()[i] * (1 - t)
    # a determinant that rounding made 0 or less has no logarithm: such flat ones stay apart
    apart = apart.where(apart.isfinite(), torch.inf).clamp(min=0)
    return weight * (apart / 2 + colour)


def matched(
    pairs: Int64[Tensor, "p 2"], cost: Float[Tensor, " p"], number: int
) -> Int64[Tensor, "q 2"]:
    """The cheapest pairs, one after another, of Gaussians that are in none yet: at most `number`.

    Args:
        pairs: Candidates.
        cost: What each costs; those that cost infinitely much are never taken.
        number: Most pairs that are taken, >= 0.

    Source: greedy matching as in NanoGS (arXiv 2603.16103).
    """
    taken: set[int] = set()
    found: list[list[int]] = []
    finite = int(cost.isfinite().sum())
    for pair in pairs[cost.argsort(stable=True)[:finite]].tolist():
        if len(found) >= number:
            break
        if pair[0] != pair[1] and not taken & set(pair):
            taken |= set(pair)
            found.append(pair)
    return torch.tensor(found, dtype=torch.int64).reshape(-1, 2)


def merged(
    model: Gaussians, pairs: Int64[Tensor, "p 2"], mass: Float[Tensor, " n"]
) -> tuple[Gaussians, Float[Tensor, " m"]]:
    """The Gaussians with each pair as one, and their masses: first those of no pair, in their order.

    Mean and covariance are those of the pair, SH coefficients its weighted mean. The opacity keeps
    the sum of opacity times area, but is not larger than 1 - (1 - a_1)(1 - a_2): two behind one
    another are no more.

    Args:
        model: The Gaussians.
        pairs: Rows of both of each pair; no row twice.
        mass: What each weighs, > 0: pixels that it is worth over the training views, say.

    Source: moments: Runnalls 2007; opacity by area as in PlayCanvas's splat-transform; its bound: ours.
    """
    i, j = pairs.unbind(dim=1)
    found = moments(model, pairs, mass)
    values, axes = torch.linalg.eigh(found.covariances)
    axes[:, :, 0] *= torch.linalg.det(axes).sign()[:, None]
    log_scales = values.clamp(min=FLAT).log() / 2
    opacity = model.opacity_logits.double().sigmoid()
    covered = opacity * areas(model.log_scales)
    most = 1 - (1 - opacity[i]) * (1 - opacity[j])
    merged_opacity = ((covered[i] + covered[j]) / areas(log_scales)).minimum(most)
    t = found.shares[:, None, None]
    one = Gaussians(
        means=found.means, quaternions=quaternions(axes), log_scales=log_scales,
        opacity_logits=merged_opacity.clamp(CLEAR, 1 - CLEAR).logit(),
        sh=t * model.sh[i].double() + (1 - t) * model.sh[j].double(),
    )  # fmt: skip
    alone = _others(pairs, len(model))
    both = {
        name: torch.cat([values[alone], new.to(values)])
        for (name, values), new in zip(vars(model).items(), vars(one).values(), strict=True)
    }
    return Gaussians(**both), torch.cat([mass[alone], mass[i] + mass[j]])


def _others(pairs: Int64[Tensor, "p 2"], count: int) -> Bool[Tensor, " n"]:
    """Which rows are in no pair."""
    alone = torch.ones(count, dtype=torch.bool)
    alone[pairs.flatten()] = False
    return alone


def quaternions(rotations: Float[Tensor, "p 3 3"]) -> Float[Tensor, "p 4"]:
    """Unit quaternions (w, x, y, z) of rotation matrices.

    Args:
        rotations: Proper rotations.

    Source: Bar-Itzhack 2000, "New method for extracting the quaternion from a rotation matrix": the
        eigenvector of the largest eigenvalue of a symmetric matrix, which no rotation makes singular.
    """
    r = rotations.unbind(dim=1)
    a, b, c = (row.unbind(dim=1) for row in r)
    rows = [
        a[0] + b[1] + c[2], c[1] - b[2], a[2] - c[0], b[0] - a[1],
        c[1] - b[2], a[0] - b[1] - c[2], b[0] + a[1], a[2] + c[0],
        a[2] - c[0], b[0] + a[1], b[1] - a[0] - c[2], c[1] + b[2],
        b[0] - a[1], a[2] + c[0], c[1] + b[2], c[2] - a[0] - b[1],
    ]  # fmt: skip
    whole = torch.stack(rows, dim=1).reshape(-1, 4, 4)
    return normalise(torch.linalg.eigh(whole).eigenvectors[:, :, -1])
