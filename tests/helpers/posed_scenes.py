"""Fixtures of the adapters: photos with one blob each at the pixel where a known point belongs.

Poses are made from looking directions; each test writes them in its set's own convention and
projects by that convention's own formula, never by the code under test.
"""

from pathlib import Path

import numpy as np
from PIL import Image

from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, View

SIZE = (96, 72)
POINTS = np.array([[0.1, -0.2, 0.3], [-0.4, 0.3, -0.1], [0.35, 0.4, 0.05]])
CENTRES = np.array([[3.0, 0.4, 1.0], [0.3, 2.8, 1.2], [-2.5, 0.5, 1.5], [0.2, -3.0, 0.7]])


def opengl_to_world(i: int) -> np.ndarray:
    """4 x 4 camera to world of view i, camera axes right, up, back, looking near the origin."""
    centre = CENTRES[i % len(CENTRES)]
    back = centre - [0.05, 0.1, 0.02]
    back = back / np.linalg.norm(back)
    right = np.cross([0.1, 0.05, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, centre], axis=1)
    return pose


def opengl_rays(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(x right, y down) on the plane at unit depth of world points."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    return np.stack([local[:, 0] / -local[:, 2], -local[:, 1] / -local[:, 2]], axis=1)


def blob(path: Path, pixel: np.ndarray, *, size: tuple[int, int] = SIZE, alpha=False) -> None:
    """Write a black image with one white blob (sigma 2) centred at a position."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    light = np.exp(-((x - pixel[0]) ** 2 + (y - pixel[1]) ** 2) / 8)
    grey = np.round(255 * light).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    if alpha:
        white = np.full_like(grey, 255)
        Image.fromarray(np.stack([white, white, white, grey], axis=-1)).save(path)
    else:
        Image.fromarray(grey).convert("RGB").save(path, quality=100, subsampling=0)


def blob_error(view: View, point: np.ndarray) -> float:
    """Pixels between a view's blob and where the view's camera sees the point."""
    light = view.load()[..., 0].numpy().astype(np.float64)
    light[light < 0.05] = 0  # JPEG leaves faint noise everywhere
    height, width = light.shape
    seen = np.array(
        [
            (light.sum(0) * (np.arange(width) + 0.5)).sum() / light.sum(),
            (light.sum(1) * (np.arange(height) + 0.5)).sum() / light.sum(),
        ]
    )
    pixel, _ = project_points(view.camera, view.camera.K.new_tensor(point[None]))
    return float(np.abs(seen - pixel[0].numpy()).max())


def worst_error(scene: Scene, points: dict[str, np.ndarray]) -> float:
    """Largest blob error over the views, each with the point painted into it."""
    assert sorted(points) == [view.name for view in scene.views]
    shift = scene.shift.numpy()
    return max(blob_error(view, points[view.name] - shift) for view in scene.views)
