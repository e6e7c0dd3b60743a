"""Paths of a camera: round the middle of a scene, or along its own cameras."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import View
from splatproof.viewing.poses import NEAREST, level, looking
from splatproof.viewing.stage import Stage


def orbit(stage: Stage, count: int, *, width: int, height: int, field: float) -> list[Camera]:
    """Cameras on a circle round the scene's middle, at its cameras' usual height and distance.

    The first stands where the first training camera is seen from the middle; without a scene they
    stand 20 degrees above the middle.

    Args:
        stage: What is shown.
        count: Cameras on the whole circle, evenly spread.
        width: Width of the image in pixels.
        height: Height of the image in pixels.
        field: Vertical field of view, degrees.
    """
    place = stage.place
    centres = [view.camera.centre.double() for view in stage.training]
    rise, away = (
        place.radius * math.sin(math.radians(20)),
        place.radius * math.cos(math.radians(20)),
    )
    ahead = torch.linalg.cross(place.up, level(place.up))
    if centres:
        apart = torch.stack(centres) - place.centre
        heights = apart @ place.up
        flat = apart - heights[:, None] * place.up
        rise, away = float(heights.median()), float(flat.norm(dim=1).median())
        if away > 1e-3 * place.radius and float(flat[0].norm()) > 1e-3 * place.radius:
            ahead = flat[0] / flat[0].norm()
        away = max(away, 0.2 * place.radius)  # right above the middle there is no circle
    side = torch.linalg.cross(place.up, ahead)
    cameras = []
    for turn in range(count):
        angle = 2 * math.pi * turn / count
        out = math.cos(angle) * ahead + math.sin(angle) * side
        eye = place.centre + rise * place.up + away * out
        cameras.append(
            looking(
                eye, place.centre - eye, place.up, field=field, width=width, height=height,
                near=NEAREST * place.radius,
            )
        )  # fmt: skip
    return cameras


def along(
    stage: Stage, count: int, *, width: int, height: int, field: float
) -> list[tuple[Camera, float | None]]:
    """Cameras and moments along the training cameras, in the order of their names.

    Positions go along a smooth curve through theirs (Catmull-Rom), orientations turn evenly from one
    to the next, moments are interpolated; the path is as fast in the picture's frames everywhere.

    Args:
        stage: What is shown; its scene has at least two training views.
        count: Cameras on the whole path.
        width: Width of the image in pixels.
        height: Height of the image in pixels.
        field: Vertical field of view, degrees.
    Raises: UsageError where there are not two training views.
    """
    views = stage.training
    if len(views) < 2:
        raise UsageError(f"a path along {len(views)} cameras: expected 2 or more; name a --scene")
    centres = torch.stack([view.camera.centre.double() for view in views])
    turns = torch.stack([view.camera.rotation.double() for view in views])
    path = []
    for index in range(count):
        at = index * (len(views) - 1) / max(1, count - 1)
        first = min(int(at), len(views) - 2)
        share = at - first
        rotation = _between(turns[first], turns[first + 1], share)
        camera = looking(
            _curve(centres, first, share), rotation[2], -rotation[1], field=field, width=width,
            height=height, near=NEAREST * stage.place.radius,
        )  # fmt: skip
        path.append((camera, _moment(views, first, share)))
    return path


def _moment(views: Sequence[View], first: int, share: float) -> float | None:
    start, end = views[first].time, views[first + 1].time
    return None if start is None or end is None else (1 - share) * start + share * end


def _curve(points: Float64[Tensor, "n 3"], first: int, t: float) -> Float64[Tensor, "3"]:
    """Catmull-Rom between points[first] and the next; ends are repeated."""
    last = len(points) - 1
    a, b, c, d = (points[min(max(first + i, 0), last)] for i in (-1, 0, 1, 2))
    return 0.5 * (
        2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
    )


def _between(
    one: Float64[Tensor, "3 3"], other: Float64[Tensor, "3 3"], share: float
) -> Float64[Tensor, "3 3"]:
    """The rotation a share of the way, about the one axis that turns one into the other."""
    step = other @ one.T
    angle = math.acos(max(-1.0, min(1.0, (float(step.trace()) - 1) / 2)))
    if angle < 1e-9:
        return one
    axis = step.new_tensor(
        [step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]]
    )
    length = float(axis.norm())
    if length < 1e-9:  # half a turn: every way is as short
        return one if share < 0.5 else other
    x, y, z = (axis / length).tolist()
    cross = step.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle *= share
    part = torch.eye(3, dtype=step.dtype) + math.sin(angle) * cross
    return (part + (1 - math.cos(angle)) * cross @ cross) @ one
