"""Which bounds on the shape of Gaussians a training keeps to, and when it looks at them."""

from collections.abc import Sequence

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.nearest_camera import NearestCamera
from splatproof.methods.training.scale_bound import ScaleBound
from splatproof.methods.training.thickness_bound import ThicknessBound
from splatproof.reference.types.scene import View

EVERY = 50
"""Steps from one look at all Gaussians to the next. With the release's rate of 0.005 a scale grows by 28 % in
between at most."""


def shape_bounds(
    widest: float, thickest: float, views: Sequence[View], parameters: Parameters
) -> tuple[ScaleBound | ThicknessBound, ...]:
    """The bounds of a training, in the order in which they are applied.

    Args:
        widest: As for `ScaleBound`; 0: no bound.
        thickest: As for `ThicknessBound`; 0: no bound.
        views: Training views.
        parameters: The model's.

    Raises: UsageError if the model has no shapes of its own that could be bounded.
    """
    for name, share in (("widest", widest), ("thickest", thickest)):
        if share and not {"means", "quaternions", "log_scales"} <= parameters.rows.keys():
            raise UsageError(
                f"setting {name} is {share:g}, expected 0: what this method trains has no scales of its own"
            )
    if not (widest or thickest):
        return ()
    cameras = NearestCamera(views)
    wide = (ScaleBound(widest, cameras),) if widest else ()
    thick = (ThicknessBound(thickest, cameras),) if thickest else ()
    return (*wide, *thick)
