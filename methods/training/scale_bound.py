"""No Gaussian much wider than the nearest camera is far: a wider one veils photos that do not show it."""

import math

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.nearest_camera import NearestCamera


class ScaleBound:
    """Scales that are at most a share of the distance to the nearest training camera, a smaller one near points.

    A projection that is linear around a Gaussian's centre is right where the Gaussian is narrow against its depth.
    A wide one well outside of an image gets a footprint that covers all of it, so that a single Gaussian of
    the far ground costs a photo that nobody trains on 10 dB, while training photos never showed it.

    Where points to start from lie close together, what is there is known in detail, and faint wide Gaussians before and behind
    it are fog to whoever does not look along the photos' rays; where there are none, wide ones have to fill the gap. So a Gaussian
    that is wider than the smaller share is at most as wide as it is far from the nearest such point.

    Source: ours; the linear projection: Zwicker et al. 2001, "EWA Volume Splatting".
    """

    def __init__(
        self,
        share: float,
        cameras: NearestCamera,
        near: float = math.inf,
        points: Float[Tensor, "p 3"] | None = None,
    ) -> None:
        """Remember the shares, where the cameras are and where the points are.

        Args:
            share: Largest standard deviation on any axis as a share of the distance, > 0; inf: no bound.
            cameras: Those of the training views.
            near: The same on points, > 0; inf: no smaller one there.
            points: Where training starts from, in scene units, at least one where `near` is finite.
        """
        self.share, self.cameras, self.near = share, cameras, near
        self.points = (
            None if math.isinf(near) or points is None else KDTree(points.detach().cpu().numpy())
        )

    def largest(self, means: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Largest scale of a Gaussian at each position, in scene units.

        Args:
            means: World positions in scene units.
        """
        distance, _ = self.cameras.look(means)
        # no bound is none on a camera either
        top = torch.nan_to_num(self.share * distance, nan=math.inf, posinf=math.inf)
        if self.points is not None:
            bare, _ = self.points.query(means.detach().cpu().numpy())
            top = torch.minimum(top, torch.maximum(self.near * distance, torch.as_tensor(bare)))
        return top.to(means)

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
