"""A pinhole camera: world to camera, OpenCV axes (x right, y down, z forward)."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

NEAR = 0.01
"""Default near plane in scene units; the public releases disagree (0.2 and 0.01), we take 0.01."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """Where a view was taken from and how rays meet pixels. Pinhole: adapters undistort first.

    The centre of pixel (column i, row j) is at (i + 0.5, j + 0.5), as in COLMAP.
    """

    K: Float[Tensor, "3 3"]
    """Intrinsics in pixels, float64."""
    world_to_camera: Float[Tensor, "4 4"]
    """Rigid, row-major: x_cam = R x_world + t. Float64."""
    width: int
    height: int
    near: float = NEAR
    """Gaussians with camera-space z <= near are not drawn. Scene units."""

    @property
    def rotation(self) -> Float[Tensor, "3 3"]:
        """R of x_cam = R x_world + t."""
        return self.world_to_camera[:3, :3]

    @property
    def translation(self) -> Float[Tensor, "3"]:
        """The vector t of x_cam = R x_world + t."""
        return self.world_to_camera[:3, 3]

    @property
    def centre(self) -> Float[Tensor, "3"]:
        """Camera centre in the world: -R^T t."""
        return -self.rotation.T @ self.translation

    def to(self, dtype: torch.dtype) -> "Camera":
        """Return the same camera with its matrices in another float dtype."""
        return replace(self, K=self.K.to(dtype), world_to_camera=self.world_to_camera.to(dtype))


def transform_points(camera: Camera, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """World points in camera space: x_cam = R x_world + t. In the points' dtype.

    Args:
        camera: The pinhole camera, whose pose is cast to the points' dtype.
        points: World positions in scene units.

    Returns: Camera-space positions (x right, y down, z forward) in scene units.
    """
    pose = camera.world_to_camera.to(points)
    return points @ pose[:3, :3].T + pose[:3, 3]


def project_points(
    camera: Camera, points: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, " n"]]:
    """Pixel positions and depths of world points.

    Args:
        camera: The pinhole camera.
        points: World positions in scene units.

    Returns: Pixel positions (x, y) and camera-space z; positions mean nothing where z <= 0.
    """
    cam = transform_points(camera, points)
    pixel = cam @ camera.K.to(cam).T
    return pixel[:, :2] / cam[:, 2:], cam[:, 2]
