"""Random scenes to time rasterizers on: every number follows from the count and the image size."""

import numpy as np
import torch
from torch import Tensor

from splatproof.reference.types.camera import Camera
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene

SH_C0 = 0.28209479177387814
TURN = 0.3
"""Angle of the camera in radians."""


def speed_scene(count: int, width: int, height: int) -> tuple[GaussianScene, Tensor]:
    """Gaussians 1 to 4 px wide all over the image, and a fixed gradient by its colour [h, w, 3].

    Positions are uniform in the image and in disparity between 2 and 10 units; scales are
    log-uniform, opacities uniform in 0.1 to 0.9, harmonics of degree 3. The seed is count + width.

    Args:
        count: Number of Gaussians.
        width: Pixels.
        height: Pixels.

    Source: ours.
    """
    draw = np.random.default_rng(count + width)
    focal = 0.9 * width
    z = 1 / draw.uniform(1 / 10.0, 1 / 2.0, count)
    u, v = draw.uniform(0, width, count), draw.uniform(0, height, count)
    local = np.stack([(u - width / 2) / focal * z, (v - height / 2) / focal * z, z], axis=1)
    axis = np.sin(TURN / 2) * np.array([1, 2, -1]) / np.sqrt(6)
    rotation = _matrix(np.cos(TURN / 2), *axis)
    shift = np.array([0.3, -0.2, 0.5])
    sigma = np.exp(draw.uniform(np.log(1.0), np.log(4.0), (count, 3)))
    turns = draw.normal(size=(count, 4))
    opacities = draw.uniform(0.1, 0.9, count)
    rgb = draw.uniform(0.05, 0.95, (count, 3))
    sh = np.zeros((count, 16, 3))
    sh[:, 0] = (rgb - 0.5) / SH_C0
    sh[:, 1:] = draw.normal(size=(count, 15, 3)) * 0.05
    gradient = draw.normal(size=(height, width, 3)) / (width * height)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    scene = GaussianScene(
        camera=Camera(
            K=_float32(intrinsics).double(), world_to_camera=_float32(pose).double(),
            width=width, height=height,
        ),
        means=_float32((local - shift) @ rotation),
        quaternions=_float32(turns / np.linalg.norm(turns, axis=1, keepdims=True)),
        scales=_float32(sigma * (z / focal)[:, None]), opacities=_float32(opacities),
        sh=_float32(sh),
    )  # fmt: skip
    return scene, _float32(gradient)


def _float32(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))


def _matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
