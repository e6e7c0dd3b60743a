"""How true the surface is that a model shows, where the scene knows the true depth of its views."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from splatproof.methods.models.base import Reconstruction
from splatproof.metrics.geometry import geometry_scores
from splatproof.metrics.seam_partition import surface_points
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, View

THRESHOLD = 0.5
"""Scene units (metres in made worlds) up to which a surface point counts as found."""
SPACING = 0.25
"""Scene units: of several points in a cube of this side one is kept, so that ground which many
views see weighs no more than a wall that one sees."""
TRAINING_VIEWS = 40
"""So many training views at most, evenly spread, beside all test views."""
STRIDE = 2
"""Every so many-th row and column is taken."""
OPAQUE = 0.5
"""Pixels of less alpha show no surface."""
SLACK = 0.02
"""A training view sees a point whose depth is within this share of its true depth there."""


def geometry_metrics(scene: Scene, model: Reconstruction) -> dict[str, float]:
    """Accuracy, completeness and F-score of the rendered depth, back-projected, against the truth.

    Expected depths of training and test views become one cloud, true depths of the same pixels the
    other. `geometry_blind_completeness` is the completeness of what test views truly see and no
    training view does.

    Returns: Empty unless all views of the scene have true depth. nan where nothing is blind.
    Source: ours; the scores are those of metrics/geometry.py.
    """
    if any(view.load_depth is None for view in scene.views):
        return {}
    step = max(1, -(-len(scene.train) // TRAINING_VIEWS))
    chosen = [*scene.train_views[::step], *scene.test_views]
    found, true, blind = [], [], []
    for view in chosen:
        depth = _truth(view)
        render = model.render(view.without_truth())
        shown = (render.alpha >= OPAQUE) & (render.depth > 0)
        found.append(_cloud(view, torch.where(shown, render.depth, torch.inf)))
        true.append(_cloud(view, depth))
        blind.append(torch.full((len(true[-1]),), view in scene.test_views))
    reference, rows = _thinned(torch.cat(true))
    unseen = torch.cat(blind)[rows]
    unseen[unseen.clone()] = ~seen_by(reference[unseen], scene.train_views)
    cloud, _ = _thinned(torch.cat(found))
    every = geometry_scores(cloud, reference, THRESHOLD)
    hidden = torch.nan
    if bool(unseen.any()):
        hidden = geometry_scores(cloud, reference, THRESHOLD, counted=unseen).completeness
    return {
        "geometry_accuracy": every.accuracy,
        "geometry_completeness": every.completeness,
        "geometry_f_score": every.f_score,
        "geometry_blind_completeness": hidden,
    }


def seen_by(points: Float64[Tensor, "n 3"], views: Sequence[View]) -> Bool[Tensor, " n"]:
    """Which points at least one of the views truly sees: in its image, at its true depth.

    Args:
        points: In the scene's frame.
        views: With true depth.
    """
    seen = torch.zeros(len(points), dtype=torch.bool)
    for view in views:
        camera = view.camera
        pixels, z = project_points(camera, points)
        size = torch.tensor([camera.width, camera.height])
        rows = ((z > camera.near) & ((pixels >= 0) & (pixels < size)).all(dim=1)).nonzero()[:, 0]
        x, y = pixels[rows].long().unbind(dim=1)
        seen[rows] |= (_truth(view)[y, x].double() - z[rows]).abs() <= SLACK * z[rows]
    return seen


def _truth(view: View) -> Tensor:
    assert view.load_depth is not None
    return view.load_depth()


def _cloud(view: View, depth: Tensor) -> Float64[Tensor, "n 3"]:
    """Points of every STRIDE-th row and column with a finite depth."""
    points = surface_points(view.camera, depth)[::STRIDE, ::STRIDE].reshape(-1, 3)
    return points[points.isfinite().all(dim=1)]


def _thinned(points: Float64[Tensor, "n 3"]) -> tuple[Float64[Tensor, "m 3"], Tensor]:
    """The first point in each cube of side SPACING, and its row."""
    if len(points) == 0:
        return points, torch.zeros(0, dtype=torch.int64)
    cells = torch.floor(points / SPACING).long()
    _, cube = torch.unique(cells, dim=0, return_inverse=True)
    first = torch.full((int(cube.max()) + 1,), len(points))
    first.scatter_reduce_(0, cube, torch.arange(len(points)), "amin")
    rows = first.sort().values
    return points[rows], rows
