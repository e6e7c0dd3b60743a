"""Manifold-balanced sampling: training views of a block drawn evenly over where they stand."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from splatproof.base.errors import DataError, UsageError

GOLDEN = (math.sqrt(5) - 1) / 2
"""The stride is the number nearest to this share of the bins that visits them all."""


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """Bins over the ring of camera centres around a block."""

    azimuths: int = 8
    """Number of bins around the block, >= 1 (StitchGS' release: 8)."""
    distances: int = 3
    """Number of bins away from the block, >= 1 (StitchGS' release: 3)."""
    uniform_share: float = 0.0
    """Share of draws, 0 to 1, that ignore the bins and take any view."""


def view_bins(
    centres: Float64[Tensor, "v 3"],
    block_centre: Float64[Tensor, "3"],
    frame: Float64[Tensor, "3 3"],
    settings: SamplingSettings,
) -> Int64[Tensor, " v"]:
    """Bin azimuth * distances + distance of each view: Phi(v) = (theta(v), r(v)).

    theta is the angle of the camera's centre around the block's, on the ground; r its distance,
    mapped so that the 5th percentile is 0 and the 95th is 1, and clamped. A camera straight above
    has azimuth 0; where all distances are equal, r is 0.

    Args:
        centres: Camera centres in the world.
        block_centre: Centre of the block in the world.
        frame: Rotation into the ground frame (ground_frame).
        settings: Numbers of bins around the block and away from it.

    Source: StitchGS, Sec. 3.2.2; numbers of bins and percentiles from its release.
    """
    if settings.azimuths < 1 or settings.distances < 1 or not 0 <= settings.uniform_share <= 1:
        raise UsageError(f"{settings}: expected at least one bin and a share in [0, 1]")
    offset = (centres - block_centre) @ frame.T
    turn = torch.atan2(offset[:, 1], offset[:, 0]) / (2 * math.pi) % 1
    azimuth = (turn * settings.azimuths).long().clamp(max=settings.azimuths - 1)
    distance = offset.norm(dim=1)
    if len(distance) == 0:
        return azimuth
    low, high = torch.quantile(distance, distance.new_tensor([0.05, 0.95]))
    radius = ((distance - low) / (high - low) if high > low else 0 * distance).clamp(0, 1)
    ring = (radius * settings.distances).long().clamp(max=settings.distances - 1)
    return azimuth * settings.distances + ring


def stride(bins: int) -> int:
    """Step that visits all bins before it repeats one: coprime with their number.

    Among these steps it is the one nearest to GOLDEN times `bins`; of two, the smaller.

    Source: StitchGS, Sec. 3.2.2 (fixed stride); coprime, its release; golden share, ours.
    """
    steps = [step for step in range(1, max(bins, 2)) if math.gcd(step, bins) == 1]
    return min(steps, key=lambda step: abs(step - GOLDEN * bins))


def balanced_draws(
    bins: Int64[Tensor, " v"], settings: SamplingSettings, generator: torch.Generator
) -> Iterator[int]:
    """Endless view indices: non-empty bins in turn by a fixed stride, shuffled inside each bin.

    A bin deals out all its views before it shuffles again, so every view is drawn. With a uniform
    share, that share of the draws is uniform over all views instead, and takes no turn.

    Args:
        bins: Bin of each view (view_bins).
        settings: Share of draws that ignore the bins.
        generator: Source of all randomness.

    Raises: DataError without views.

    Source: StitchGS, Sec. 3.2.2 (low-variance inverse-density schedule).
    """
    if len(bins) == 0:
        raise DataError("no views to draw from: give the block at least one training view")
    members = [(bins == bin_).nonzero()[:, 0] for bin_ in bins.unique()]
    hands: list[list[int]] = [[] for _ in members]
    step, turn = stride(len(members)), 0
    while True:
        if float(torch.rand((), generator=generator)) < settings.uniform_share:
            yield int(torch.randint(len(bins), (), generator=generator))
            continue
        if not hands[turn]:
            order = torch.randperm(len(members[turn]), generator=generator)
            hands[turn] = members[turn][order].tolist()
        yield hands[turn].pop()
        turn = (turn + step) % len(members)
