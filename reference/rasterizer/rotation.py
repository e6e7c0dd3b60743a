"""Quaternions, rotation matrices and the covariance of a Gaussian."""

import torch
from jaxtyping import Float
from torch import Tensor


def normalise(quaternions: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
    """Unit quaternions; a zero quaternion becomes the identity with zero gradient.

    Dividing by the largest component first keeps norms of 1e-30 and 1e30 exact.

    Source: ours (spec: hard cases).
    """
    largest = quaternions.detach().abs().amax(dim=1, keepdim=True)
    zero = largest == 0
    identity = torch.tensor([1.0, 0, 0, 0]).to(quaternions)
    safe = torch.where(zero, identity, quaternions / torch.where(zero, 1, largest))
    return safe / safe.norm(dim=1, keepdim=True)


def rotation_matrix(quaternions: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z), normalised here.

    Args:
        quaternions: Any norm; zero is the identity.

    Returns: Proper rotations; column j is the world direction of local axis j.
    """
    w, x, y, z = normalise(quaternions).unbind(dim=1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)


def half_covariance(
    quaternions: Float[Tensor, "n 4"], scales: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3 3"]:
    """The factor H = R diag(s) of each covariance Sigma = H H^T.

    Args:
        quaternions: (w, x, y, z), any norm; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
    """
    return rotation_matrix(quaternions) * scales[:, None, :]


def covariance(
    quaternions: Float[Tensor, "n 4"], scales: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3 3"]:
    """Covariance Sigma = R diag(s^2) R^T of each Gaussian, in squared scene units.

    Args:
        quaternions: (w, x, y, z), any norm; zero is the identity.
        scales: Standard deviations in scene units, >= 0.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 6.
    """
    half = half_covariance(quaternions, scales)
    return half @ half.mT
