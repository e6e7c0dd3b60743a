"""Which bounds on the shape of Gaussians a training keeps to, and when it looks at them."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.nearest_camera import NearestCamera
from splatproof.methods.training.scale_bound import ScaleBound
from splatproof.methods.training.thickness_bound import ThicknessBound
from splatproof.reference.types.scene import View

EVERY = 50
"""Steps from one look at all Gaussians to the next. With the release's rate of 0.005 a scale grows by 28 % in
between at most."""


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """Bounds on the shape of Gaussians, each a share of the distance to the nearest training camera; 0: no bound."""

    widest: float = 0.0
    """Largest scale."""
    widest_at_points: float = 0.0
    """Largest scale on points that training starts from; away from them it is the distance to the nearest one."""
    thickest: float = 0.0
    """Largest extent along the ray to that camera."""


def shape_bounds(
    shapes: Shapes, views: Sequence[View], parameters: Parameters
) -> tuple[ScaleBound | ThicknessBound, ...]:
    """The bounds of a training, in the order in which they are applied.

    Args:
        shapes: What is bounded.
        views: Training views.
        parameters: The model's at its start: its Gaussians' positions are the points that training starts from.

    Raises: UsageError if the model has no shapes of its own that could be bounded.
    """
    asked = {name: share for name, share in asdict(shapes).items() if share}
    if not asked:
        return ()
    if not {"means", "quaternions", "log_scales"} <= parameters.rows.keys():
        (name, share), *_ = asked.items()
        raise UsageError(
            f"setting {name} is {share:g}, expected 0: what this method trains has no scales of its own"
        )
    cameras, bounds = NearestCamera(views), []
    if shapes.widest or shapes.widest_at_points:
        bounds.append(
            ScaleBound(
                shapes.widest or math.inf, cameras,
                shapes.widest_at_points or math.inf, parameters.rows["means"],
            )
        )  # fmt: skip
    if shapes.thickest:
        bounds.append(ThicknessBound(shapes.thickest, cameras))
    return tuple(bounds)
