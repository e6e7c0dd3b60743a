"""No Gaussian much thicker along a photo's rays than anything shows: what photos do not see, others see as fog."""

import itertools

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.nearest_camera import NearestCamera
from splatproof.reference.rasterizer.rotation import half_covariance, rotation_matrix

ORDERS = torch.tensor(list(itertools.permutations(range(3))))
"""Every order of three axes."""


class ThicknessBound:
    """Gaussians whose extent along the ray to the nearest training camera is at most a share of its length.

    How far a Gaussian reaches along a ray, the camera of that ray cannot see: with covariance Sigma, unit vector d along
    the ray and A = I - (1 - f) d d^T, the flattened covariance A Sigma A has the same image there for every f, because
    the projection's derivative along d is zero, and f times the standard deviation along d. Photos from one side
    (all from above, say) leave that extent free; growing Gaussians then reach far above and below the surface, and
    whoever looks along it sees fog.

    Source: ours; the projection: Zwicker et al. 2001, "EWA Volume Splatting".
    """

    def __init__(self, share: float, cameras: NearestCamera) -> None:
        """Remember the share and where the cameras are.

        Args:
            share: Largest standard deviation along the ray as a share of its length, > 0.
            cameras: Those of the training views.
        """
        self.share, self.cameras = share, cameras

    @torch.no_grad()
    def apply(self, parameters: Parameters) -> None:
        """Flatten what is too thick along its ray, in place; nothing else changes.

        Each axis stays the one that it is nearest to, so that what an optimizer remembers of it stays true, and
        quaternions keep their norm.

        Args:
            parameters: With rows means, quaternions and log_scales.
        """
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        distance, rays = (each.to(rows["means"]) for each in self.cameras.look(rows["means"]))
        half = half_covariance(rows["quaternions"], rows["log_scales"].exp())
        thickness = (half * rays[:, :, None]).sum(dim=1).norm(dim=1)
        thick = torch.where(thickness > self.share * distance)[0]
        if not len(thick):
            return
        factor = (self.share * distance[thick] / thickness[thick]).double()
        ray = rays[thick].double()
        flat = half[thick].double()
        flat = flat - (1 - factor)[:, None, None] * ray[:, :, None] * (ray[:, None, :] @ flat)
        before = rotation_matrix(rows["quaternions"][thick].double())
        turned, scales = axes(flat, before)
        norm = rows["quaternions"][thick].norm(dim=1, keepdim=True)
        rows["quaternions"][thick] = norm * quaternions(turned).to(norm)
        least = torch.finfo(rows["log_scales"].dtype).tiny
        rows["log_scales"][thick] = scales.clamp(min=least).log().to(norm)


def axes(
    half: Float[Tensor, "n 3 3"], before: Float[Tensor, "n 3 3"]
) -> tuple[Float[Tensor, "n 3 3"], Float[Tensor, "n 3"]]:
    """Rotation and scales with R diag(s^2) R^T = H H^T, each axis the one nearest to it of another rotation.

    No mirror: in the order of largest likeness and with signs that agree, the cosines between old and new axes add up to
    more than 1 (each row's do, and the mean over orders is their sum over three), of a mirror to at most 1.

    Args:
        half: Any factor H of each covariance.
        before: The other rotations.

    Returns: Proper rotations R, axes in columns, and standard deviations s >= 0.
    """
    columns, scales, _ = torch.linalg.svd(half)
    likeness = (before.mT @ columns).abs()  # of old axis i and new axis j
    fits = torch.stack(
        [likeness[:, range(3), order].sum(dim=1) for order in ORDERS.tolist()], dim=1
    )
    order: Int[Tensor, "n 3"] = ORDERS[fits.argmax(dim=1)].to(half.device)
    columns = columns.gather(2, order[:, None, :].expand(-1, 3, -1))
    signs = (before * columns).sum(dim=1).sign()
    return columns * signs[:, None, :], scales.gather(1, order)


def quaternions(rotations: Float[Tensor, "n 3 3"]) -> Float[Tensor, "n 4"]:
    """Unit quaternions (w, x, y, z) of proper rotations.

    Args:
        rotations: Axes in columns.
    """
    last = Rotation.from_matrix(rotations.cpu().numpy()).as_quat()
    return torch.as_tensor(np.roll(last, 1, axis=1)).to(rotations)
