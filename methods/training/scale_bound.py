"""No Gaussian much wider than the nearest camera is far: a wider one veils photos that do not show it."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.reference.types.scene import View

EVERY = 50
"""Steps from one look at all scales to the next. With the release's rate of 0.005 a scale grows by 28 % in
between at most."""


class ScaleBound:
    """Scales that are at most a share of the distance to the nearest training camera.

    A projection that is linear around a Gaussian's centre is right where the Gaussian is narrow against its depth.
    A wide one well outside of an image gets a footprint that covers all of it, so that a single Gaussian of
    the far ground costs a photo that nobody trains on 10 dB, while training photos never showed it.

    Source: ours; the linear projection: Zwicker et al. 2001, "EWA Volume Splatting".
    """

    def __init__(self, share: float, views: Sequence[View]) -> None:
        """Remember where the cameras are.

        Args:
            share: Largest standard deviation on any axis as a share of the distance, > 0.
            views: Training views, at least one.
        """
        self.share = share
        self.cameras = KDTree(torch.stack([view.camera.centre.double() for view in views]).cpu())

    def largest(self, means: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Largest scale of a Gaussian at each position, in scene units.

        Args:
            means: World positions in scene units.
        """
        distance, _ = self.cameras.query(means.detach().cpu().numpy())
        return (self.share * torch.as_tensor(distance)).to(means)

    @torch.no_grad()
    def apply(self, parameters: Parameters) -> None:
        """Lower what is above the bound, in place; nothing else changes.

        Args:
            parameters: With rows means and log_scales.
        """
        scales = parameters.rows["log_scales"].detach()
        # a Gaussian on a camera keeps a scale whose logarithm is finite
        least = torch.finfo(scales.dtype).tiny
        top = self.largest(parameters.rows["means"]).clamp(min=least).log()
        torch.minimum(scales, top[:, None], out=scales)


def scale_bound(share: float, views: Sequence[View], parameters: Parameters) -> ScaleBound | None:
    """The bound of a training; None where none is asked for.

    Args:
        share: As for `ScaleBound`; 0: no bound.
        views: Training views.
        parameters: The model's.

    Raises: UsageError if the model has no scales of its own that could be bounded.
    """
    if not share:
        return None
    if not {"means", "log_scales"} <= parameters.rows.keys():
        raise UsageError(
            f"setting widest is {share:g}, expected 0: what this method trains has no scales of its own"
        )
    return ScaleBound(share, views)
