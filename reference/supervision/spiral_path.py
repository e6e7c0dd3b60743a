"""Spiral side-view sampling: a descent of orbits that leads from the roofs to the facades."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

NADIR = 1e-6
"""Sine of the angle to the up vector below which another up vector is taken."""


@dataclass(frozen=True, kw_only=True)
class SpiralSettings:
    """Shape of the spiral. The paper gives no numbers: these are ours."""

    layers: int = 4
    """L: number of orbits, from the flight height down."""
    views: int = 12
    """Number of views on each orbit."""
    radius: float = 1.0
    """Orbit radius in footprint radii; at least 1, so that the orbit encloses the scene."""
    look_up: float = 0.6
    """Share of its own height at which the lowest orbit looks, in [0, 1); the top one looks at the
    ground."""


def look_at(
    eye: Float[Tensor, "3"], target: Float[Tensor, "3"], up: Float[Tensor, "3"]
) -> Float[Tensor, "4 4"]:
    """World-to-camera pose with the target on the axis and up towards the top of the image.

    Where the view direction is parallel to up (nadir), the world axis least parallel to it takes
    the place of up.

    Args:
        eye: Camera centre in the world, scene units.
        target: World position in the middle of the image, scene units.
        up: Direction of the image's top in the world, any length > 0.

    Raises: ValueError if eye and target coincide.

    Source: DPGS, Eq. 2 (its argument order is target, eye, up).
    """
    forward = target - eye
    if not float(forward.norm()) > 0:
        raise ValueError(f"eye and target coincide: {eye.tolist()}")
    forward = forward / forward.norm()
    right = torch.linalg.cross(forward, up / up.norm())
    if float(right.norm()) < NADIR:
        axis = torch.eye(3).to(forward)[forward.abs().argmin()]
        right = torch.linalg.cross(forward, axis)
    right = right / right.norm()
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose = torch.eye(4).to(forward)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    return pose


def spiral_path(
    centre: Float[Tensor, "3"],
    up: Float[Tensor, "3"],
    footprint: float,
    flight_height: float,
    settings: SpiralSettings,
) -> Float[Tensor, "layers views 4 4"]:
    """World-to-camera poses LookAt(c + dh_l u_z, o_lk, u_up), highest orbit first.

    Orbit l flies at height H (1 - l / L), so the lowest is at H / L, above the ground; neighbours
    are turned by half a step against each other. The look-at height dh_l grows in even steps from
    0 (roofs in view, as in the training views) to `look_up` of the lowest orbit's height (facades
    in view).

    Args:
        centre: Scene centre on the ground, scene units.
        up: Unit vector against gravity.
        footprint: Radius of the scene's footprint, > 0, scene units.
        flight_height: H_max above the ground, > 0, scene units.
        settings: Numbers of orbits and views, radius of the orbits and height they look at.

    Raises: ValueError if a length is not positive, or an orbit has no views.

    Source: DPGS, Sec. 3.2, Eq. 2.
    """
    if not (footprint > 0 and flight_height > 0) or min(settings.layers, settings.views) < 1:
        raise ValueError(
            f"need positive lengths and at least one view: footprint {footprint}, flight height "
            f"{flight_height}, {settings.layers} x {settings.views} views"
        )
    side = torch.eye(3).to(up)[up.abs().argmin()]
    east = torch.linalg.cross(up, side)
    east = east / east.norm()
    north = torch.linalg.cross(up, east)
    poses = []
    for layer in range(settings.layers):
        height = flight_height * (1 - layer / settings.layers)
        sinking = layer / max(1, settings.layers - 1)
        rise = settings.look_up * sinking * flight_height / settings.layers
        target = centre + rise * up
        for view in range(settings.views):
            turn = 2 * torch.pi * up.new_tensor((view + layer / 2) / settings.views)
            around = turn.cos() * east + turn.sin() * north
            eye = centre + height * up + settings.radius * footprint * around
            poses.append(look_at(eye, target, up))
    return torch.stack(poses).reshape(settings.layers, settings.views, 4, 4)


def block_spiral(
    low: Float[Tensor, "3"],
    high: Float[Tensor, "3"],
    up: Float[Tensor, "3"],
    flight_height: float,
    settings: SpiralSettings,
) -> Float[Tensor, "layers views 4 4"]:
    """The spiral around one block of a city; one around the whole city sees outer facades only.

    Its centre is the middle of the box on the box's ground, its footprint half the box's diagonal
    across up.

    Args:
        low: Lower corner of the block's bounds, scene units.
        high: Upper corner of the block's bounds, scene units.
        up: Unit vector against gravity.
        flight_height: H_max above the block's ground, > 0, scene units.
        settings: Numbers of orbits and views, radius of the orbits and height they look at.

    Returns: World-to-camera poses, highest orbit first; see `spiral_path`.

    Raises: ValueError if the box has no extent across up, or the flight height is not positive.

    Source: ours (the paper draws one spiral and names no blocks for it).
    """
    middle, half = (low + high) / 2, (high - low) / 2
    corners = torch.cartesian_prod(*torch.tensor([[-1.0, 1.0]] * 3)).to(half) * half
    rise = corners @ up
    footprint = float((corners - rise[:, None] * up).norm(dim=1).max())
    return spiral_path(middle + rise.min() * up, up, footprint, flight_height, settings)
