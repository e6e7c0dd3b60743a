"""Seams that are planted, to see whether metrics see them and merges mend them: each block's photos are a little wrong."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.training.initialise import extent
from splatproof.methods.training.schedules import require
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, View

Image = Float[Tensor, "h w 3"]


@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """What differs from block to block in what it is trained on; 0: nothing."""

    light: float = 0.0
    """Natural logarithm of the largest factor on a colour of a block's photos: 0.2 makes red up to 22 % brighter
    in one block and darker in another. On average over blocks and colours nothing is brighter."""
    shift: float = 0.0
    """How far along the ground a block's cameras are moved, all of them the same way, as a share of the scene's
    extent (1.1 times the largest distance of a training camera to their mean)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("light", "shift"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"planted.{name}", value, "finite and >= 0")


NO_PLANT = PlantSettings()


def planted_views(
    scene: Scene, planted: PlantSettings, block: int, blocks: int, frame: Float[Tensor, "3 3"]
) -> tuple[View, ...]:
    """A scene's views as one block of it is to see them.

    Blocks differ as points of a circle do: block b of K has the angle 2 pi b / K. Its factor on colour c is
    exp(light cos(angle + 2 pi c / 3)); its cameras are moved by shift times the extent into the direction of
    the angle along the ground.

    Args:
        scene: The whole scene.
        planted: What differs.
        block: Number of the block.
        blocks: How many there are (K).
        frame: Rotation from the scene into the ground frame, whose last axis is up.
    Source: ours.
    """
    angle = 2 * math.pi * block / blocks
    colours = torch.arange(3) * (2 * math.pi / 3)
    factors = (planted.light * (angle + colours).cos()).exp()
    along = torch.tensor([math.cos(angle), math.sin(angle), 0.0]).to(frame)
    move = planted.shift * extent(scene) * (along @ frame)
    return tuple(_changed(view, factors, move) for view in scene.views)


def _changed(view: View, factors: Float[Tensor, "3"], move: Float[Tensor, "3"]) -> View:
    return replace(view, camera=_moved(view.camera, move), load=partial(_lit, view.load, factors))


def _moved(camera: Camera, move: Float[Tensor, "3"]) -> Camera:
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= pose[:3, :3] @ move.to(pose)
    return replace(camera, world_to_camera=pose)


def _lit(load: Callable[[], Image], factors: Float[Tensor, "3"]) -> Image:
    return (load() * factors).clamp(0, 1)
