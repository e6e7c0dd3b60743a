"""The scale and zero that bring a disparity nearest to another: what a prior leaves open."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior

ROUNDS = 20
"""Weighted fits; each gives less weight to what the one before did not meet."""
FLOOR = 1e-3
"""Residuals below this share of the median target count alike."""
LEAST_POINTS = 10
"""SfM points of a view from which its scale and zero are fitted; with fewer they stay."""


def aligned(
    values: Float[Tensor, " n"], targets: Float[Tensor, " n"]
) -> tuple[float, float] | None:
    """Scale a and shift b with least sum |a x + b - t|; None where they are not determined.

    Least absolute deviations by reweighted least squares: a minority of wrong targets, spread over
    the range of disparities, hardly moves them.

    Args:
        values: Disparities x of a prior.
        targets: Disparities t that they are to become, > 0.
    Source: scale and shift in disparity: Ranftl et al. 2020 (MiDaS); fit: ours.
    """
    x, t = values.double(), targets.double()
    if len(x) < 2 or float(x.max() - x.min()) <= 1e-6 * float(x.abs().max()):
        return None
    design = torch.stack([x, torch.ones_like(x)], dim=1)
    floor = FLOOR * float(t.abs().median())
    weights = torch.ones_like(x)
    solution = torch.zeros(2, dtype=torch.float64)
    for _ in range(ROUNDS):
        weighted = design * weights[:, None]
        solution = torch.linalg.lstsq(weighted.T @ design, weighted.T @ t).solution
        weights = 1 / (design @ solution - t).abs().clamp(min=floor)
    return float(solution[0]), float(solution[1])


def in_scale(prior: DepthPrior, camera: Camera, points: Float[Tensor, "n 3"]) -> DepthPrior:
    """The prior with the scale and zero that its SfM points say; as it is where they are too few.

    Args:
        prior: Disparity, near the scene's own scale: poses may be off.
        camera: The view's camera.
        points: Sparse points that the view sees.
    """
    return _scaled(prior, camera, points) or prior


def scaled_prior(
    load: Callable[[], DepthPrior], camera: Camera, points: Float[Tensor, "n 3"]
) -> DepthPrior:
    """A prior of any scale in that of its SfM points; nothing is valid where they do not determine it.

    Args:
        load: Reads the prior.
        camera: The view's camera.
        points: Sparse points that the view sees.
    """
    prior = load()
    nothing = DepthPrior(disparity=prior.disparity, valid=torch.zeros_like(prior.valid))
    return _scaled(prior, camera, points) or nothing


def _scaled(prior: DepthPrior, camera: Camera, points: Float[Tensor, "n 3"]) -> DepthPrior | None:
    """The prior moved to fit the points; None where they do not say how."""
    at, z = project_points(camera, points)
    column, row = at.floor().long().T
    inside = (z > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    column, row, z = column[inside], row[inside], z[inside]
    known = prior.valid[row, column]
    if int(known.sum()) < LEAST_POINTS:
        return None
    fit = aligned(prior.disparity[row[known], column[known]], 1 / z[known])
    if fit is None or fit[0] <= 0:
        return None
    moved = torch.where(prior.valid, fit[0] * prior.disparity + fit[1], 0)
    return DepthPrior(disparity=moved, valid=prior.valid)
