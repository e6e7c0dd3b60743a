"""How true the depth and surface are that a model shows, where the scene knows its views' depth."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.metrics.depth import depth_errors
from splatproof.metrics.geometry import completeness, geometry_scores
from splatproof.metrics.parts import mean_over_images
from splatproof.metrics.seam_partition import surface_points
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, View

THRESHOLD = 0.5
"""Scene units (metres in made worlds) up to which a surface point counts as found."""
SPACING = 0.25
"""Side of a cube in scene units in which one of several points is kept, so that ground which many
views see weighs no more than a wall that one sees."""
TRAINING_VIEWS = 40
"""Most training views that are looked at, evenly spread, beside all test views."""
STRIDE = 2
"""Distance in pixels of the rows and columns of a depth image that become surface points."""
OPAQUE = 0.5
"""Alpha from which a pixel shows a surface."""
SLACK = 0.02
"""Largest share of its depth by which a point that a view sees may miss the view's true depth."""


def geometry_metrics(scene: Scene, model: Reconstruction) -> dict[str, float]:
    """Errors of the rendered depth of scored views, and of the surface that all views show.

    The first are those of metrics/depth.py, where any scored view has true depth. The second, where
    all views of the scene have it: expected depths of training and test views become one cloud, true
    depths of the same pixels the other, and they have accuracy, completeness and F-score.
    `geometry_blind_completeness` is the completeness of what test views truly see and no training
    view does. Each view is rendered once.

    Args:
        scene: The scene; its test views are the scored ones.
        model: What is judged, by what it renders.
    Returns: depth_... and geometry_... by name, see metrics/scene_registry.py; empty where no true
        depth is known. nan where nothing is blind.
    Raises: DataError naming a view in which the model's depth is negative or not finite.
    Source: ours; the scores are those of metrics/depth.py and metrics/geometry.py.
    """
    whole = all(view.load_depth is not None for view in scene.views)
    step = max(1, -(-len(scene.train) // TRAINING_VIEWS))
    chosen = [(view, False) for view in scene.train_views[::step] if whole]
    chosen += [(view, True) for view in scene.test_views if view.load_depth is not None]
    errors, found, true, blind = [], [], [], []
    for view, scored in chosen:
        depth = _truth(view)
        render = model.render(view.without_truth())
        if scored:
            errors.append(_depth_errors(view, render.depth, depth))
        if whole:
            shown = (render.alpha >= OPAQUE) & (render.depth > 0)
            found.append(_cloud(view, torch.where(shown, render.depth, torch.inf)))
            true.append(_cloud(view, depth))
            blind.append(torch.full((len(true[-1]),), scored))
    surface = _surface(scene, *map(torch.cat, (found, true, blind))) if whole else {}
    return _mean_errors(errors) | surface


def _depth_errors(view: View, depth: Tensor, truth: Tensor) -> dict[str, float]:
    """Errors of a view's depth where its mask has it scored."""
    try:
        return depth_errors(depth, truth, None if view.load_mask is None else view.load_mask())
    except DataError as error:
        raise DataError(f"{view.name}: {error}") from error


def _mean_errors(views: Sequence[dict[str, float]]) -> dict[str, float]:
    """Means over the views in which any pixel counts: the truth decides which these are."""
    return {
        f"depth_{name.removeprefix('depth_')}": mean_over_images([view[name] for view in views])
        for name in (views[0] if views else ())
    }


def _surface(scene: Scene, found: Tensor, true: Tensor, blind: Tensor) -> dict[str, float]:
    """Scores of the cloud that the model shows against the true one.

    Args:
        scene: The scene, with true depth of all views.
        found: Points that the model shows.
        true: Points of the true surface.
        blind: Which true points are of a test view.
    """
    reference, rows = _thinned(true)
    unseen = blind[rows]
    unseen[unseen.clone()] = ~seen_by(reference[unseen], scene.train_views)
    cloud, _ = _thinned(found)
    every = geometry_scores(cloud, reference, THRESHOLD)
    hidden = torch.nan
    if bool(unseen.any()):
        hidden = completeness(cloud, reference[unseen], THRESHOLD)
    return {
        "geometry_accuracy": every.accuracy,
        "geometry_completeness": every.completeness,
        "geometry_f_score": every.f_score,
        "geometry_blind_completeness": hidden,
    }


def seen_by(points: Float64[Tensor, "n 3"], views: Sequence[View]) -> Bool[Tensor, " n"]:
    """Which points at least one of the views truly sees: in its image, at its true depth.

    Args:
        points: Points in the scene's frame.
        views: Views with true depth.
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
    cube = np.zeros(len(points), dtype=np.int64)
    for axis in torch.floor(points / SPACING).long().unbind(dim=1):
        # numbered anew after each axis: never above len(points)^2, however far the points lie
        _, place = np.unique(axis.numpy(), return_inverse=True)
        _, cube = np.unique(cube * (place.max() + 1) + place, return_inverse=True)
    rows = torch.from_numpy(np.sort(np.unique(cube, return_index=True)[1]))
    return points[rows], rows
