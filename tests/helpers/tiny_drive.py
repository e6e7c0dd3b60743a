"""A drive small enough to train on in a test: blobs that stay, blobs that move, sweeps and a sky."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from helpers.tiny_scene import camera, random_gaussians, sparse_points
from splatproof.methods.dynamic.sweep_points import TimedPoints, joined
from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.rasterizer.spherical_harmonics import C0
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, Sweep, View

SPEED = 2.0
"""Units a second at which blobs move along x."""
MOVING = 4
"""Blobs that move, the last of all."""
SKY_COLOUR = (0.4, 0.6, 0.9)


def truth_at(seconds: float, *, count: int = 30, speed: float = SPEED) -> Gaussians:
    """The blobs at a moment; those that move are in front of the others, large and opaque."""
    blobs = random_gaussians(count)
    means, sizes, opaque = (
        value.clone() for value in (blobs.means, blobs.log_scales, blobs.opacity_logits)
    )
    means[-MOVING:] *= 0.5
    means[-MOVING:, 0] += speed * (seconds - 0.35)
    means[-MOVING:, 2] -= 0.5
    sizes[-MOVING:] = math.log(0.12)
    opaque[-MOVING:] = 4.0
    return replace(blobs, means=means, log_scales=sizes, opacity_logits=opaque)


def tiny_drive(*, moments: int = 8, count: int = 30, speed: float = SPEED) -> Scene:
    """A photo, a sweep and a sky mask every 0.1 s from a camera that drives by. Moment 3 is held out.

    Sparse points are the blobs that stay; a sweep has points of all blobs where they are.
    """

    def view(index: int) -> View:
        where, seconds = camera(index % 6), 0.1 * index
        blobs = truth_at(seconds, count=count, speed=speed)
        output = rasterizer.rasterize(
            where, blobs.means, blobs.quaternions, blobs.scales, blobs.opacities, sh=blobs.sh
        )
        behind = (1 - output.alpha)[..., None] * torch.tensor(SKY_COLOUR)
        return View(
            name=f"{index}.png", camera=where, time=seconds,
            load=partial(torch.clone, (output.colour + behind).clamp(0, 1)),
            load_sky=partial(torch.clone, output.alpha < 0.01),
            load_sweep=partial(
                Sweep, positions=blobs.means.clone(), origin=where.centre, time=seconds
            ),
        )  # fmt: skip

    held_out = 3
    return Scene(
        name="tiny drive", root=Path("nowhere"), views=tuple(view(i) for i in range(moments)),
        train=tuple(i for i in range(moments) if i != held_out), test=(held_out,),
        points=sparse_points(truth_at(0.0, count=count).means[:-MOVING].double()),
        up=torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64), units="metres",
        shift=torch.zeros(3, dtype=torch.float64),
    )  # fmt: skip


def moving_returns(views: Sequence[View]) -> TimedPoints:
    """What perfect sweeps of some views would say of the blobs that move."""
    parts = []
    for view in views:
        assert view.time is not None
        blobs = truth_at(view.time)
        colours = (0.5 + C0 * blobs.sh[-MOVING:, 0]).clamp(0, 1)
        parts.append(
            TimedPoints(
                positions=blobs.means[-MOVING:].double(), colours=(255 * colours).byte(),
                seconds=torch.full((MOVING,), view.time).double(),
                moved=torch.ones(MOVING, dtype=torch.bool),
                velocities=torch.tensor([[SPEED, 0.0, 0.0]]).repeat(MOVING, 1),
            )
        )  # fmt: skip
    return joined(parts)


def moving_pixels(view: View, *, count: int = 30) -> Tensor:
    """Where a photo shows a blob that moves."""
    assert view.time is not None
    blobs = truth_at(view.time, count=count)
    part = slice(count - MOVING, count)
    return rasterizer.rasterize(
        view.camera, blobs.means[part], blobs.quaternions[part], blobs.scales[part],
        blobs.opacities[part], sh=blobs.sh[part],
    ).alpha > 0.3  # fmt: skip
