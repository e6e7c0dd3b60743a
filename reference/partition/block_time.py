"""How long blocks train, before they do: a model with three coefficients, its fit, and weights that even times out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.optimize import nnls
from torch import Tensor

from splatproof.base.errors import DataError


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Processor seconds of one training step of one view, by what it works on."""

    pixel: float
    """For each pixel of the view: compositing and loss."""
    gaussian: float
    """For each Gaussian that the block holds: what is done to all of them, Adam foremost."""
    seen: float
    """For each Gaussian that the view sees: projection, sorting, compositing and their gradients."""

    def __post_init__(self) -> None:
        """Refuse coefficients that are not finite and >= 0, or all 0."""
        values = tuple(vars(self).values())
        if not all(0 <= value < float("inf") for value in values) or not any(values):
            raise DataError(f"{self}: expected finite numbers >= 0, one of them above 0")


@dataclass(frozen=True, kw_only=True)
class BlockWork:
    """What the training of one block works on."""

    steps: float
    """Number of its training steps, one view each."""
    pixels: float
    """Mean number of pixels of its views."""
    gaussians: float
    """Mean number of Gaussians that it holds, whatever their role, over the steps."""
    seen: float
    """Mean number of these that one of its views sees."""

    @property
    def parts(self) -> tuple[float, float, float]:
        """What each coefficient of a StepCost is multiplied by, over all steps."""
        return (
            self.steps * self.pixels, self.steps * self.gaussians, self.steps * self.seen,
        )  # fmt: skip


def block_seconds(work: BlockWork, cost: StepCost) -> float:
    """T = S (a P + b G + c n): processor seconds of a block's training.

    With S = E V steps (E visits of each of V views) it is E (a P V + b V G + c W): W = V n, the sum of the
    track lengths that DPGS balances, is one of three parts of it.

    Args:
        work: S, P, G and n.
        cost: a, b and c.

    Source: ours; W: DPGS, Sec. 3.3.
    """
    return float(np.dot(work.parts, (cost.pixel, cost.gaussian, cost.seen)))


def fit_step_cost(works: Sequence[BlockWork], seconds: Sequence[float]) -> StepCost:
    """The coefficients >= 0 with the least sum of squared relative errors of the blocks' seconds.

    Args:
        works: What blocks worked on; three that differ, at least, tell the coefficients apart.
        seconds: What each of them took, > 0.

    Raises: DataError without blocks, for times that are not finite and above 0, or for work that is
        none.

    Source: ours; non-negative least squares: Lawson and Hanson 1974.
    """
    times = np.array(seconds, dtype=np.float64)
    if len(works) != len(times) or not len(times):
        raise DataError(f"{len(times)} times of {len(works)} blocks: expected one of each, at least one")
    if not (np.isfinite(times) & (times > 0)).all():
        raise DataError("block times: expected finite seconds above 0")
    parts = np.array([work.parts for work in works], dtype=np.float64) / times[:, None]
    # columns of one size: a pixel's seconds are a millionth of a block's
    sizes = np.linalg.norm(parts, axis=0)
    found = nnls(parts / np.where(sizes > 0, sizes, 1), np.ones(len(times)))[0]
    pixel, gaussian, seen = (found / np.where(sizes > 0, sizes, np.inf)).tolist()
    return StepCost(pixel=pixel, gaussian=gaussian, seen=seen)


def reweighted(
    weights: Float64[Tensor, " n"], labels: Int64[Tensor, " n"], seconds: Float64[Tensor, " k"]
) -> Float64[Tensor, " n"]:
    """Weights of points with which a cut into blocks of equal weight has blocks of more equal times.

    Points of a block that takes longer than the mean become as much heavier, so that the next cut gives their
    place fewer of them. What all points weigh together stays as it is. In a block of no weight nothing
    changes.

    Args:
        weights: What each point weighed in the last cut, >= 0.
        labels: Block of each point in that cut.
        seconds: What each block would take, >= 0.

    Source: ours.
    """
    total = weights.sum()
    held = torch.zeros_like(seconds).index_add_(0, labels, weights)
    # a block's new weight is its share of the seconds
    wanted = total * seconds / seconds.sum().clamp(min=torch.finfo(torch.float64).tiny)
    factor = torch.where(held > 0, wanted / held.clamp(min=1e-300), 1.0)
    changed = weights * factor[labels]
    return changed * (total / changed.sum().clamp(min=1e-300))
