"""Cameras that nobody took a photo from: where they stand and what they look at."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, View

NEAREST, FARTHEST = 0.01, 100.0
"""Near plane of free cameras, in radii of the scene; and how far away they may stand."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Where there is something to look at."""

    centre: Float[Tensor, "3"]
    """Middle of what the cameras look at, float64, scene frame."""
    radius: float
    """Typical distance of the cameras from there, scene units; more than 0."""
    up: Float[Tensor, "3"]
    """Unit vector against gravity, float64."""


def looking(
    eye: Float[Tensor, "3"],
    forward: Float[Tensor, "3"],
    up: Float[Tensor, "3"],
    *,
    field: float,
    width: int,
    height: int,
    near: float,
) -> Camera:
    """The pinhole camera at a place, its principal point in the middle of the image.

    Args:
        eye: Centre of the camera, float64, scene frame.
        forward: Where it looks; any length but 0.
        up: What is up in its image; not along `forward`.
        field: Vertical field of view in degrees, 0 to 180, exclusive.
        width: Width of the image in pixels.
        height: Height in pixels.
        near: Near plane in scene units.
    Raises: UsageError where the directions say no orientation.
    """
    ahead = forward / forward.norm()
    right = torch.linalg.cross(ahead, up)
    if not bool(right.isfinite().all()) or float(right.norm()) <= 1e-9 * float(up.norm()):
        raise UsageError(
            f"a camera looks along {forward.tolist()} with {up.tolist()} up: expected two directions"
        )
    right = right / right.norm()
    rotation = torch.stack([right, torch.linalg.cross(ahead, right), ahead])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    focal = height / 2 / math.tan(math.radians(field) / 2)
    K = torch.tensor(
        [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64
    )
    return Camera(K=K, world_to_camera=pose, width=width, height=height, near=near)


def resized(camera: Camera, width: int) -> Camera:
    """The same camera with an image of another width, its height in proportion (at least 1).

    Args:
        camera: Any camera.
        width: Pixels.
    """
    height = max(1, round(camera.height * width / camera.width))
    scale = camera.K.new_tensor([width / camera.width, height / camera.height, 1.0])
    return replace(camera, K=camera.K * scale[:, None], width=width, height=height)


def level(up: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """A direction at right angles to up, from which headings are counted.

    Args:
        up: Unit vector, float64.
    """
    axis = torch.eye(3, dtype=torch.float64)[int(up.abs().argmin())]
    across = axis - (axis @ up) * up
    return across / across.norm()


def place_of_scene(scene: Scene) -> Place:
    """The point nearest to the axes of all training cameras, and how far they are from it.

    Where axes are parallel, as above a survey, the least squares have no answer along them: the
    middle of the sparse points has, towards which the point is pulled a little.

    Args:
        scene: With at least one view.
    """
    views = scene.train_views or scene.views
    centres = torch.stack([view.camera.centre.double() for view in views])
    axes = torch.stack([view.camera.rotation.double()[2] for view in views])
    positions = scene.points.positions.double()
    around = (
        positions.median(dim=0).values if len(positions) else centres.mean(dim=0) + axes.mean(0)
    )
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    pull = 0.05 * len(views) * torch.eye(3, dtype=torch.float64)
    right_side = (across @ centres[:, :, None]).sum(dim=0)[:, 0] + pull @ around
    centre = torch.linalg.solve(across.sum(dim=0) + pull, right_side)
    radius = float((centres - centre).norm(dim=1).median())
    return Place(centre=centre, radius=max(radius, 1e-6), up=scene.up.double())


def place_of_points(means: Float[Tensor, "n 3"]) -> Place:
    """Where a model without a scene is: the middle of its Gaussians, twice their spread away.

    Args:
        means: Positions in scene units, at least one. Up is taken to be -y, as in COLMAP's frames.
    """
    centre = means.double().median(dim=0).values
    spread = float((means.double() - centre).norm(dim=1).median())
    up = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    return Place(centre=centre, radius=max(2 * spread, 1e-6), up=up)


def typical_field(views: tuple[View, ...]) -> float:
    """Median vertical field of view of some cameras, degrees; 50 where there are none.

    Args:
        views: Any number.
    """
    fields = [2 * math.atan(v.camera.height / 2 / float(v.camera.K[1, 1])) for v in views]
    return math.degrees(float(torch.tensor(fields).median())) if fields else 50.0
