"""Random sets of Gaussians before a camera, as the rasterizers take them."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatproof.reference.types.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianScene:
    """Float32 parameters, so that every rasterizer starts from the same numbers."""

    camera: Camera
    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor

    def arguments(self, dtype: torch.dtype) -> list[Tensor]:
        """Fresh leaves: means, quaternions, scales, opacities, sh."""
        values = (self.means, self.quaternions, self.scales, self.opacities, self.sh)
        return [v.detach().to(dtype).clone().requires_grad_() for v in values]

    def but(self, **changes: Tensor | Camera) -> "GaussianScene":
        """The same scene with some parameters replaced."""
        return replace(self, **changes)


def camera_at(width: int, height: int, *, turn: float = 0.1, near: float = 0.01) -> Camera:
    """A camera near the origin that looks along +z, turned a little about y and x.

    Args:
        width: Pixels of a row.
        height: Rows of pixels.
        turn: Angle about y in radians; about x it is -0.7 times as large.
        near: Depth of the near plane in scene units, > 0.
    """
    a, b = torch.tensor([turn, -0.7 * turn], dtype=torch.float64)
    yaw, pitch = torch.eye(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
    yaw[0, 0] = yaw[2, 2] = a.cos()
    yaw[0, 2], yaw[2, 0] = a.sin(), -a.sin()
    pitch[1, 1] = pitch[2, 2] = b.cos()
    pitch[1, 2], pitch[2, 1] = -b.sin(), b.sin()
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = pitch @ yaw
    pose[:3, 3] = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64) * (turn != 0)
    focal = 0.9 * max(width, height)
    K = torch.tensor(
        [[focal, 0, 0.5 * width], [0, 1.05 * focal, 0.48 * height], [0, 0, 1]], dtype=torch.float64
    )
    return Camera(K=K, world_to_camera=pose, width=width, height=height, near=near)


def random_scene(count: int, seed: int, *, width: int = 33, height: int = 21, degree: int = 3):
    """Gaussians in and around the field of view: 0.3 to 8 px wide, of every opacity.

    Args:
        count: Number of Gaussians, >= 0.
        seed: Seed of the draw, >= 0.
        width: Pixels of a row.
        height: Rows of pixels.
        degree: Degree of the spherical harmonics, 0 to 3.
    """
    g = torch.Generator().manual_seed(seed)
    camera = camera_at(width, height, turn=0.1 + 0.1 * (seed % 5))
    z = 0.5 + 5 * torch.rand(count, generator=g)
    focal = float(camera.K[0, 0])
    spread = 1.4 * torch.tensor([width, height]) / focal
    xy = (torch.rand(count, 2, generator=g) - 0.5) * spread * z[:, None]
    cam = torch.cat([xy, z[:, None]], dim=1)
    cam[::17, 2] *= -1  # some lie behind the camera
    pose = camera.world_to_camera
    means = (cam.double() - pose[:3, 3]) @ pose[:3, :3]
    pixels = torch.exp(torch.rand(count, 3, generator=g) * 3.3 - 1.2)
    return GaussianScene(
        camera=camera,
        means=means.float(),
        quaternions=torch.randn(count, 4, generator=g),
        scales=pixels * z[:, None] / focal,
        opacities=torch.rand(count, generator=g) ** 0.7,
        sh=torch.randn(count, (degree + 1) ** 2, 3, generator=g) * 0.3,
    )
