"""A slanted wall with a pattern of waves, seen by a row of cameras; all of it by formula."""

import math
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from helpers.tiny_scene import tiny_scene
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, SparsePoints, View

WIDTH, HEIGHT, FOCAL = 64, 48, 70.0
NORMAL, FAR = (-0.3, 0.2, 1.0), 5.0
"""The wall holds the points X with NORMAL . X = FAR, in units of the scene's."""


def camera(place: tuple[float, float, float], turn: float = 0.0, unit: float = 1.0) -> Camera:
    """A camera that looks along z, turned about that by degrees."""
    a = math.radians(turn)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:2, :2] = pose.new_tensor([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    pose[:3, 3] = -pose[:3, :3] @ (unit * pose.new_tensor(place))
    K = pose.new_tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Camera(K=K, world_to_camera=pose, width=WIDTH, height=HEIGHT, near=0.01 * unit)


def wall_depth(where: Camera, unit: float = 1.0) -> Float[Tensor, "h w"]:
    """z-depth of the wall at each pixel."""
    row, column = torch.meshgrid(
        torch.arange(where.height) + 0.5, torch.arange(where.width) + 0.5, indexing="ij"
    )
    pixel = torch.stack([column, row, torch.ones_like(row)], dim=-1).double()
    ray = (pixel @ torch.linalg.inv(where.K).T) @ where.rotation
    normal = ray.new_tensor(NORMAL)
    return ((unit * FAR - where.centre @ normal) / (ray @ normal)).float()


def on_wall(where: Camera, unit: float = 1.0) -> Float[Tensor, "h w 3"]:
    """The wall's points at the middles of pixels."""
    row, column = torch.meshgrid(
        torch.arange(where.height) + 0.5, torch.arange(where.width) + 0.5, indexing="ij"
    )
    pixel = torch.stack([column, row, torch.ones_like(row)], dim=-1).double()
    local = (pixel @ torch.linalg.inv(where.K).T) * wall_depth(where, unit).double()[..., None]
    return (local - where.translation) @ where.rotation


def pattern(points: Float[Tensor, "h w 3"], unit: float = 1.0) -> Float[Tensor, "h w 3"]:
    """Waves of 6 to 25 pixels, other ones in each colour."""
    draw = torch.Generator().manual_seed(3)
    ways = torch.randn(12, 2, generator=draw).double()
    ways = (
        2.8 * torch.rand(12, 1, generator=draw).double().add(0.3) * ways / ways.norm(dim=1)[:, None]
    )
    phase = 6.3 * torch.rand(12, 3, generator=draw).double()
    waves = torch.sin(2.4 * (points[..., :2] / unit @ ways.T)[..., None] + phase)
    return (0.5 + 0.12 * waves.sum(dim=-2)).clamp(0, 1).float()


def view(name: str, where: Camera, unit: float = 1.0) -> View:
    """A photo of the wall, with its true depth."""
    photo, depth = pattern(on_wall(where, unit), unit), wall_depth(where, unit)
    return View(
        name=name, camera=where, load=partial(torch.clone, photo), load_depth=depth.clone
    )  # fmt: skip


def textured_scene(turn: float = 0.0, unit: float = 1.0) -> Scene:
    """Three training views of the wall; the second is turned by degrees; its points are seen by all.

    Args:
        turn: Degrees.
        unit: Length of what is 1 elsewhere.
    """
    places = ((0.0, 0.0, 0.0), (0.5, 0.1, 0.1), (-0.4, 0.2, 0.0))
    views = tuple(
        view(f"{i}.png", camera(place, turn if i == 1 else 0.0, unit), unit)
        for i, place in enumerate(places)
    )
    points = on_wall(views[0].camera, unit)[6:-6:7, 8:-8:7].reshape(-1, 3)
    count = len(points)
    return replace(
        tiny_scene(),
        name="wall", views=views, train=(0, 1, 2), test=(),
        points=SparsePoints(
            positions=points, colours=torch.full((count, 3), 128, dtype=torch.uint8),
            track_starts=3 * torch.arange(count + 1),
            track_views=torch.arange(3).repeat(count),
        ),
    )  # fmt: skip
