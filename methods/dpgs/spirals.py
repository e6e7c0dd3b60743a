"""Where side views of a scene are taken from: a spiral around each part of its ground."""

import itertools
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.dpgs.settings import SideSettings
from splatproof.reference.supervision.spiral_path import block_spiral
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene

WITHIN = (0.02, 0.98)
"""Quantiles of the points along each axis that bound the scene: stray points do not widen it."""


def side_cameras(scene: Scene, settings: SideSettings) -> tuple[Camera, ...]:
    """Cameras on the spirals, with the first training camera's lens; none where there is no ground.

    The flight height is that of the middle training camera above the points' 2 % quantile. Boxes stand upright, whatever way
    the scene's own axes lie, so that their ground is the scene's.

    Args:
        scene: Its training cameras, points and up vector count.
        settings: Number and shape of the spirals.

    Source: DPGS, Sec. 3.2, Eq. 2; bounds and heights: ours.
    """
    points = scene.points.positions.double()
    if len(points) < 2 or not scene.train:
        return ()
    rise = points @ scene.up
    ground = float(rise.quantile(WITHIN[0]))
    eyes = torch.stack([view.camera.centre.double() for view in scene.train_views]) @ scene.up
    height = float(eyes.median()) - ground
    if height <= 0:
        return ()
    lens = scene.train_views[0].camera
    upright = torch.eye(4).double()
    upright[:3, :3] = least_turn(scene.up)
    up = upright[:3, :3] @ scene.up
    return tuple(
        replace(lens, world_to_camera=(pose @ upright).to(lens.world_to_camera))
        for low, high in parts(points @ upright[:3, :3].T, up, settings.spirals)
        for pose in block_spiral(low, high, up, height, settings.spiral).reshape(-1, 4, 4)
    )


def least_turn(up: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """The rotation by the smallest angle after which up lies along an axis; none where it does already.

    Args:
        up: Unit vector, float64.

    Source: Rodrigues' formula, with the axis that is nearest to up for its aim.
    """
    nearest = up.abs().argmax()
    aim = torch.zeros_like(up)
    aim[nearest] = up[nearest].sign()
    x, y, z = torch.linalg.cross(up, aim).tolist()
    cross = up.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return torch.eye(3).to(up) + cross + cross @ cross / (1 + up @ aim)


def parts(
    points: Float[Tensor, "n 3"], up: Float[Tensor, "3"], count: int
) -> list[tuple[Float[Tensor, "3"], Float[Tensor, "3"]]]:
    """Lower and upper corners of the ground's parts: a near-square grid over what holds the points.

    Args:
        points: Positions in scene units, at least one, turned so that up lies along an axis.
        up: Unit vector against gravity, along an axis; the two others are cut.
        count: Number of parts, >= 1; more go along the longer side.
    """
    low, high = torch.quantile(points, points.new_tensor(WITHIN), dim=0)
    rows = next(n for n in range(int(count**0.5), 0, -1) if count % n == 0)
    axes = sorted(up.abs().argsort()[:2].tolist(), key=lambda axis: float(low[axis] - high[axis]))
    cuts = dict(zip(axes, (count // rows, rows), strict=True))
    found = [(low, high)]
    for axis, number in cuts.items():
        found = [one for box in found for one in _cut(*box, axis, number)]
    return found


def _cut(
    low: Float[Tensor, "3"], high: Float[Tensor, "3"], axis: int, number: int
) -> list[tuple[Float[Tensor, "3"], Float[Tensor, "3"]]]:
    walls = torch.linspace(float(low[axis]), float(high[axis]), number + 1).to(low)
    found = []
    for begin, end in itertools.pairwise(walls):
        one, other = low.clone(), high.clone()
        one[axis], other[axis] = begin, end
        found.append((one, other))
    return found
