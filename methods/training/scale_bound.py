"""No Gaussian much wider than the nearest camera is far: a wider one veils photos that do not show it."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.nearest_camera import NearestCamera


class ScaleBound:
    """Scales that are at most a share of the distance to the nearest training camera.

    A projection that is linear around a Gaussian's centre is right where the Gaussian is narrow against its depth.
    A wide one well outside of an image gets a footprint that covers all of it, so that a single Gaussian of
    the far ground costs a photo that nobody trains on 10 dB, while training photos never showed it.

    Source: ours; the linear projection: Zwicker et al. 2001, "EWA Volume Splatting".
    """

    def __init__(self, share: float, cameras: NearestCamera) -> None:
        """Remember the share and where the cameras are.

        Args:
            share: Largest standard deviation on any axis as a share of the distance, > 0.
            cameras: Those of the training views.
        """
        self.share, self.cameras = share, cameras

    def largest(self, means: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Largest scale of a Gaussian at each position, in scene units.

        Args:
            means: World positions in scene units.
        """
        distance, _ = self.cameras.look(means)
        return (self.share * distance).to(means)

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
