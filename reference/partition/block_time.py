"""How long blocks train, before they do: a model with three coefficients, its fit, and weights that even times out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from scipy.optimize import nnls
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.types.camera import Camera, project_points

TILE = 16
"""Side of a tile in pixels."""
REACH = 3.0
"""Standard deviations to which a Gaussian shows."""
MOST = 4_000_000
"""Views x Gaussians up to which each pair is looked at."""


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Processor seconds of one training step of one view, by what it works on."""

    pixel: float
    """For each pixel of the view: compositing and loss."""
    gaussian: float
    """For each Gaussian that the block holds: what is done to all of them, Adam foremost."""
    pair: float
    """For each pair of a Gaussian and a tile of the view that it may show in: sorting, compositing, gradients."""

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
    pairs: float
    """Mean number of pairs of one of these and a tile of one of its views, see `pairs_a_view`."""

    @property
    def parts(self) -> tuple[float, float, float]:
        """What each coefficient of a StepCost is multiplied by, over all steps."""
        return (
            self.steps * self.pixels, self.steps * self.gaussians, self.steps * self.pairs,
        )  # fmt: skip


def block_seconds(work: BlockWork, cost: StepCost) -> float:
    """T = S (a P + b G + c n): processor seconds of a block's training.

    With S = E V steps (E visits of each of V views) it is E (a P V + b V G + c V n): V n is what DPGS balances,
    if pairs are what a view sees of a block, and one of three parts.

    Args:
        work: S, P, G and n.
        cost: a, b and c.

    Source: ours; V n: DPGS, Sec. 3.3.
    """
    return float(np.dot(work.parts, (cost.pixel, cost.gaussian, cost.pair)))


def tile_pairs(
    camera: Camera, means: Float[Tensor, "n 3"], sizes: Float[Tensor, " n"]
) -> Float64[Tensor, " n"]:
    """Tiles of an image that each Gaussian may show in: those that the square around its middle meets.

    The square's half side is REACH sizes, projected. What lies before the near plane shows in none.

    Args:
        camera: Camera of the image.
        means: Middles in scene units.
        sizes: Largest standard deviation of each, in scene units.

    Source: ours; tiles as in Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 6.
    """
    at, depth = project_points(camera, means.double())
    shown = depth > camera.near
    focal = camera.K.diagonal()[:2].to(at)
    half = REACH * sizes.double()[:, None] * focal / torch.where(shown, depth, 1)[:, None]
    size = at.new_tensor([camera.width, camera.height])
    low = ((at - half) / TILE).floor().maximum(torch.zeros_like(size))
    high = ((at + half) / TILE).floor().minimum(((size - 1) / TILE).floor())
    sides = (high - low + 1).clamp(min=0)
    shown &= (at - half < size).all(dim=1)  # the last tiles may reach beyond the image
    return torch.where(shown, sides.prod(dim=1), 0)


def pairs_a_view(
    cameras: Sequence[Camera], means: Float[Tensor, "n 3"], sizes: Float[Tensor, " n"]
) -> float:
    """Mean number of pairs of Gaussian and tile in a view; 0 without views or Gaussians.

    Where views x Gaussians are more than MOST, every so manieth Gaussian stands for its neighbours in the list.

    Args:
        cameras: Cameras of the views.
        means: Middles of the Gaussians, in scene units.
        sizes: Largest standard deviation of each, in scene units.

    Source: ours.
    """
    if not len(cameras) or not len(means):
        return 0.0
    every = -(-len(cameras) * len(means) // MOST)
    some, of = means[::every], sizes[::every]
    found = sum(float(tile_pairs(camera, some, of).sum()) for camera in cameras)
    return found / len(cameras) * len(means) / len(some)


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
        raise DataError(
            f"{len(times)} times of {len(works)} blocks: expected one of each, at least one"
        )
    if not (np.isfinite(times) & (times > 0)).all():
        raise DataError("block times: expected finite seconds above 0")
    parts = np.array([work.parts for work in works], dtype=np.float64) / times[:, None]
    # columns of one size: a pixel's seconds are a millionth of a block's
    sizes = np.linalg.norm(parts, axis=0)
    found = nnls(parts / np.where(sizes > 0, sizes, 1), np.ones(len(times)))[0]
    pixel, gaussian, pair = (found / np.where(sizes > 0, sizes, np.inf)).tolist()
    return StepCost(pixel=pixel, gaussian=gaussian, pair=pair)


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
