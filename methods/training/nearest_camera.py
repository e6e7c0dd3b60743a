"""Which training camera is nearest to a Gaussian, and how far it is."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.reference.types.scene import View


class NearestCamera:
    """The cameras of views, to be asked which one is nearest."""

    def __init__(self, views: Sequence[View]) -> None:
        """Remember where the cameras are.

        Args:
            views: At least one.
        """
        self.centres = torch.stack([view.camera.centre.double() for view in views]).cpu()
        self.tree = KDTree(self.centres)

    def look(self, means: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
        """How far the nearest camera is from each position, and from where it is seen.

        Args:
            means: World positions in scene units.

        Returns: Distances in scene units, and unit vectors from the camera to the position (of a position on a
            camera: zero). Both float64, on the CPU.
        """
        there = means.detach().double().cpu()
        distance, index = (torch.as_tensor(found) for found in self.tree.query(there.numpy()))
        ray = there - self.centres[index]
        return distance, ray / torch.where(distance > 0, distance, 1)[:, None]
