"""Stochastic interwoven stitching: blocks compete for, or share, the rims in which they overlap."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.partition.boxes import Region

RIM = 1.1
"""Normalised distance up to which primitives compete; beyond it they are dropped."""
CORE, COMPETITIVE, DROPPED = 0, 1, 2
"""Numbers of the three zones: kept, competing for the rim, dropped."""


@dataclass(frozen=True, kw_only=True)
class StitchSettings:
    """How blocks compete. The defaults are ours; `AS_RELEASED` are the authors' code's."""

    neighbours: int = 5
    """Number of Gaussians that speak for another block at a place, >= 1 (K; the paper: 2, 5 or
    11)."""
    sharpness: float = 30.0
    """How surely the better block wins, >= 0 (eta): 0 keeps half of what competes, large values
    make the winner take all."""
    normalise: bool = True
    """Whether the quality Q of a Gaussian, opacity over size in 1 / scene units, is divided by its
    median over all that competes; the release does not."""
    from_logits: bool = False
    """Whether Q has the opacity's logit for the opacity, as in the release."""
    epsilon: float = 1e-12
    """Length in scene units that is added to the size in Q, so that nothing is divided by 0 (the
    release: 1e-6)."""
    keep_unopposed: bool = True
    """Whether what no other block reaches is kept; else it competes with a score of 0, as in the
    release."""


AS_RELEASED = StitchSettings(normalise=False, from_logits=True, epsilon=1e-6, keep_unopposed=False)
"""The authors' code: a negative logit (opacity under 1/2) turns the distance weight around."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainedBlock:
    """What stitching needs to know of one trained block."""

    box: Region
    """Where it lies before the margin of training: an OrientedBox in the paper; any other shape
    with a distance of its own competes alike."""
    means: Float[Tensor, "n 3"]
    opacity_logits: Float[Tensor, " n"]
    log_scales: Float[Tensor, "n 3"]


def zones(distances: Float[Tensor, " n"]) -> Int64[Tensor, " n"]:
    """CORE where d <= 1, COMPETITIVE where 1 < d <= 1.1, DROPPED beyond.

    Source: StitchGS, Sec. 3.2.3.
    """
    return (distances > 1).long() + (distances > RIM).long()


def quality(block: TrainedBlock, settings: StitchSettings) -> Float64[Tensor, " n"]:
    """Confidence Q(p) = opacity / (mean(exp(log_scale)) + eps), in 1 / scene units.

    Args:
        block: The primitives to be judged.
        settings: Whether logits stand in for opacity, and epsilon.

    Source: StitchGS, Sec. 3.2.3.
    """
    logits = block.opacity_logits.double()
    opacity = logits if settings.from_logits else torch.sigmoid(logits)
    return opacity / (block.log_scales.double().exp().mean(dim=1) + settings.epsilon)


def weight(distances: Float64[Tensor, " n"]) -> Float64[Tensor, " n"]:
    """Decay over the rim: w(d) = max(0, 1.1 - d).

    Source: StitchGS, Sec. 3.2.3.
    """
    return (RIM - distances).clamp(min=0)


def nearest_mean(
    at: Float64[Tensor, "m 3"], means: Float64[Tensor, "n 3"], values: Float64[Tensor, " n"], k: int
) -> Float64[Tensor, " m"]:
    """Mean of the values of the k nearest means, or of all n if there are fewer; n >= 1.

    Args:
        at: Places to be asked about, scene units.
        means: Positions that hold the values, at least one, scene units.
        values: Value at each position.
        k: Number of neighbours, at least 1.
    """
    count = min(k, len(means))
    nearest = np.asarray(KDTree(means.numpy()).query(at.numpy(), k=count)[1], dtype=np.int64)
    return values[torch.from_numpy(nearest).reshape(len(at), count)].mean(dim=1)


def keep_probability(
    own: Float64[Tensor, " n"], rival: Float64[Tensor, " n"], sharpness: float
) -> Float64[Tensor, " n"]:
    """P_keep = sigmoid(eta (S_self - max_j S_j)).

    Args:
        own: Score S_self of each primitive in its own block.
        rival: Strongest score max_j S_j of another block at its place.
        sharpness: eta >= 0: 0 gives 1/2 for all, larger values favour the higher score more.

    Source: StitchGS, Sec. 3.2.3.
    """
    return torch.sigmoid(sharpness * (own - rival))


def keep_probabilities(
    blocks: tuple[TrainedBlock, ...], settings: StitchSettings
) -> tuple[Float64[Tensor, " _"], ...]:
    """Probability with which each primitive of each block stays: 1 in the core, 0 beyond 1.1.

    In between S_self = w(d_i(p)) Q(p) meets the strongest S_j = w(d_j(p)) mean Q(K nearest of
    block j). Rivals are primitives of block j that are not dropped themselves. Where no other block
    reaches (all w(d_j) are 0, or it has nothing there), the primitive is kept: the paper is silent,
    and stitching must never open a hole.

    Args:
        blocks: All blocks; their order does not matter.
        settings: Number of neighbours, sharpness and the choices in Q.

    Raises: UsageError for K < 1 or a sharpness that is negative or not finite.

    Source: StitchGS, Sec. 3.2.3; unopposed primitives and normalised Q: ours (spec: SIS).
    """
    if settings.neighbours < 1 or not 0 <= settings.sharpness < float("inf"):
        raise UsageError(f"{settings}: expected neighbours >= 1 and a finite sharpness >= 0")
    distances = [block.box.distance(block.means.double()) for block in blocks]
    qualities = [quality(block, settings) for block in blocks]
    if settings.normalise:
        rims = [q[zones(d) == COMPETITIVE] for q, d in zip(qualities, distances, strict=True)]
        unit = torch.cat(rims).median() if sum(map(len, rims)) else torch.ones(())
        qualities = [q / unit if unit > 0 else q for q in qualities]
    alive = [zones(d) != DROPPED for d in distances]

    result = []
    for i, block in enumerate(blocks):
        zone = zones(distances[i])
        rim = (zone == COMPETITIVE).nonzero()[:, 0]
        at = block.means[rim].double()
        rival = at.new_full((len(at),), -torch.inf if settings.keep_unopposed else 0.0)
        for j, other in enumerate(blocks):
            reach = weight(other.box.distance(at))
            near = (reach > 0).nonzero()[:, 0]
            if j == i or len(near) == 0 or not bool(alive[j].any()):
                continue
            local = nearest_mean(
                at[near],
                other.means[alive[j]].double(),
                qualities[j][alive[j]],
                settings.neighbours,
            )
            rival[near] = rival[near].maximum(reach[near] * local)
        own = weight(distances[i][rim]) * qualities[i][rim]
        chance = keep_probability(own, rival, settings.sharpness)
        probability = (zone == CORE).double()
        probability[rim] = torch.where(rival.isneginf(), 1.0, chance)
        result.append(probability)
    return tuple(result)


def stitch(
    blocks: tuple[TrainedBlock, ...], settings: StitchSettings, generator: torch.Generator
) -> tuple[Bool[Tensor, " _"], ...]:
    """Which primitives of each block the merged model keeps: one Bernoulli draw each.

    Numbers are drawn block by block in the order of the boxes' centres, so the order in which the
    blocks are given does not matter.

    Args:
        blocks: All trained blocks, before their overlaps are cut away.
        settings: Number of neighbours, sharpness and the choices in Q.
        generator: Source of the draws.

    Returns: One mask a block, in the order in which the blocks are given.

    Source: StitchGS, Sec. 3.2.3; order of the draws: ours.
    """
    probabilities = keep_probabilities(blocks, settings)
    kept = [torch.zeros(0, dtype=torch.bool)] * len(blocks)
    for i in sorted(range(len(blocks)), key=lambda i: blocks[i].box.centre.tolist()):
        draw = torch.rand(len(probabilities[i]), generator=generator, dtype=torch.float64)
        kept[i] = draw < probabilities[i]
    return tuple(kept)


def overlapping(distances: Float64[Tensor, "k n"], overlap: float) -> Bool[Tensor, "k n"]:
    """Which blocks keep, whole, what they hold at each place, where cores reach to d = 1 + overlap.

    Up to a block's own border, d_i <= 1, a place is the nearest block's, the first of equals: with an overlap
    of 0 that is the hard cut. Beyond, for 1 < d_i <= 1 + overlap, block i keeps what it has there too. Nothing is weighted:
    where two blocks have trained one surface its optical depth is there twice, and so are its bytes. That
    is the paper's own rule, "core primitives are always kept", for cores that overlap. The paper does not say whether
    its half-extents are those before the margin of training or after; its merge adds 2 to 83 % of storage (Tables 8
    and 9), and cores that abut can add no more than their rims. `shares` of the widened distances
    weight what lies in the overlap, so that nothing is there twice.

    Args:
        distances: Normalised distance of each place to each of at least one block, before the margin.
        overlap: Share o >= 0 by which a core is longer than its block; 0.15 is the margin that StitchGS' release trains.

    Source: StitchGS, Sec. 3.2.1 (margin) and 3.2.3 (cores); that these are cores of the widened boxes: ours.
    """
    blocks = torch.arange(len(distances))[:, None]
    own = (blocks == distances.argmin(dim=0)) & (distances <= 1)
    return own | ((distances > 1) & (distances <= 1 + overlap))


def shares(distances: Float64[Tensor, "k n"]) -> Float64[Tensor, "k n"]:
    """What each block has of each place, falling across a wall from both sides alike; they sum to 1.

    In proportion to min(1, (1.1 - d) / 0.2), which is 1 up to d = 0.9, a half on the block's border and
    0 from d = 1.1 on. A place that no block reaches is its nearest blocks'.

    Args:
        distances: Normalised distance of each place to each block.

    Source: ours; SIS, in whose rims only one of two neighbours competes, as the paper has it: see `stitch`.
    """
    if distances.shape[1] == 0:
        return distances
    width = 2 * (RIM - 1)
    reach = ((RIM - distances) / width).clamp(0, 1)
    nearest = (distances == distances.amin(dim=0)).to(distances)
    reach = torch.where(reach.sum(dim=0) > 0, reach, nearest)
    return reach / reach.sum(dim=0)


def faded(logits: Float[Tensor, " n"], share: Float64[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Opacity logits of a' = 1 - (1 - a)^s: a share s of the optical depth -log(1 - a).

    Where blocks show one surface with one opacity and their shares sum to 1, their optical depths sum to
    the surface's, and together they let through as much light as one of them did.

    Args:
        logits: Opacity logits.
        share: s in (0, 1]; 1 changes nothing.

    Source: ours.
    """
    depth = share * torch.nn.functional.softplus(logits.double())
    lowered = depth + (-torch.expm1(-depth)).log()
    return torch.where(share == 1, logits, lowered.to(logits))
