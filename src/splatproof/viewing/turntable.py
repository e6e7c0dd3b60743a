"""What a film shows: cameras and moments of a path, and the picture of each."""

import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.types.camera import Camera
from splatproof.viewing.asked import Asked
from splatproof.viewing.frames import picture_of
from splatproof.viewing.paths import along, orbit
from splatproof.viewing.poses import typical_field
from splatproof.viewing.stage import Stage

WIDEST_FIELD = 75.0
"""Degrees that the film's height shows at most."""


def cameras(
    stage: Stage, path: Literal["orbit", "cameras"], count: int, *, width: int, height: int
) -> list[tuple[Camera, float | None]]:
    """Cameras of a path with their moments: those of the cameras, or the scene's time from its start.

    Args:
        stage: What is shown.
        path: Round the scene, or along its training cameras.
        count: Frames.
        width: Width of the image in pixels.
        height: Height of the image in pixels.
    Raises: UsageError for a path along fewer than two cameras.
    """
    field = _field(stage, width / height)
    if path == "cameras":
        return along(stage, count, width=width, height=height, field=field)
    first, last = stage.times or (None, None)
    moments = [
        None if first is None or last is None else first + (last - first) * i / max(1, count - 1)
        for i in range(count)
    ]
    return list(
        zip(orbit(stage, count, width=width, height=height, field=field), moments, strict=True)
    )


def _field(stage: Stage, aspect: float) -> float:
    """Vertical field in which the film shows as much, across, as the usual training photo."""
    views = stage.training
    usual = typical_field(views)
    if views:
        shape = sorted(view.camera.width / view.camera.height for view in views)[len(views) // 2]
        across = math.tan(math.radians(usual) / 2) * shape
        usual = 2 * math.degrees(math.atan(across / aspect))
    return min(WIDEST_FIELD, usual)


@torch.no_grad()
def still(stage: Stage, camera: Camera, time: float | None, mode: str) -> Float[Tensor, "h w 3"]:
    """One frame, in [0, 1].

    Args:
        stage: Its first model is shown.
        camera: Where it is seen from.
        time: Seconds since the scene's first view; None: the model stands still.
        mode: One of `modes.MODES`.
    """
    asked = Asked(
        camera=camera, mode=mode, model=0, other=None, split=0.5, time=time, light=None, photo=None,
        quality=100,
    )  # fmt: skip
    return picture_of(stage, asked)[0]
