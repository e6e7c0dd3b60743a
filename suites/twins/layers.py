"""The layered memory drawn into another view: the reference in torch against one pass over the layers."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.kernels import guide_depth as native
from splatproof.reference.layered_memory import guide_depth
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.supervision.spiral_path import look_at
from splatproof.reference.types.camera import Camera
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
HEIGHT = 20.0
"""The memory's camera stands so far above the ground, scene units; what it sees is as wide."""
ROOF, TALLEST = 10, 3.0
"""Side of a roof in pixels of that camera, and the height of the tallest, scene units."""
COVERED = 4
"""One pixel in so many has the ground below its roof as a second layer."""
EYE = torch.tensor([8.0, 0.0, 12.0], dtype=torch.float64)


def looking(eye: Tensor, width: int, height: int, focal: float) -> Camera:
    """A camera that looks at the origin.

    Args:
        eye: Where it stands, scene units.
        width: Pixels.
        height: Pixels.
        focal: Focal length in pixels.
    """
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(
        K=intrinsics.double(), world_to_camera=look_at(eye, torch.zeros_like(eye), UP), width=width,
        height=height,
    )  # fmt: skip


def town(size: Size) -> Problem:
    """Roofs of random heights from straight above, size[0] pixels a side, seen from the side in size[1] x size[2]."""
    side, width, height = size
    draw = torch.Generator().manual_seed(side)
    above = looking(HEIGHT * UP, side, side, float(side))
    blocks = -(-side // ROOF)
    roofs = TALLEST * torch.rand(blocks, blocks, generator=draw, dtype=torch.float64)
    roofs = roofs.repeat_interleave(ROOF, 0).repeat_interleave(ROOF, 1)[:side, :side].reshape(-1)
    tops = HEIGHT - roofs - 0.1 * torch.rand(side * side, generator=draw, dtype=torch.float64)
    pixels = torch.arange(side * side)
    below = pixels[::COVERED]
    ground = HEIGHT + 0.1 * torch.rand(len(below), generator=draw, dtype=torch.float64)
    pixels, order = torch.cat([pixels, below]).sort(stable=True)
    depths = torch.cat([tops, ground])[order].float().double()
    centres = torch.stack([pixels % side, pixels // side], dim=1) + 0.5
    rays = torch.cat([(centres - side / 2) / side, torch.ones(len(centres), 1)], dim=1)
    local = rays.double() * depths[:, None]
    positions = (local - above.translation) @ above.rotation
    memory = LayeredDepth(
        camera=above, merge_distance=0.0, most_layers=2, pixels=pixels, depths=depths,
        positions=positions, colours=torch.zeros_like(positions), counts=torch.ones_like(pixels),
    )  # fmt: skip
    return Problem(
        leaves={}, given={"memory": memory, "camera": looking(EYE, width, height, 0.9 * width)}
    )


def layers(size: Size) -> int:
    """Layers of `town`."""
    return size[0] ** 2 + -(-(size[0] ** 2) // COVERED)


def draws(render: Callable[..., tuple[Tensor, Tensor]]) -> Callable[..., Any]:
    """A twin of the drawing; its output is the depth, 0 where nothing is."""

    def call(_: Leaves, given: Mapping[str, Any]) -> Tensor:
        return render(given["memory"], given["camera"])[0]

    return functional(call)


GUIDE_DEPTH = Component(
    name="guide depth",
    problem=town,
    reference=Twin(
        name="reference float64", start=draws(guide_depth.render), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=draws(native.render), dtype=torch.float64),
        Twin(name="torch", start=draws(guide_depth.render), dtype=torch.float64),
    ),
    # both compute in doubles: what is off by more than their rounding is another layer
    max_abs_error=1e-9, usual="cpu", judged=(60, 120, 90), tiny=(20, 32, 24),
    cases=(Case(size=(160, 240, 180), quick=True), Case(size=(160, 400, 300)), Case(size=(500, 240, 180))),
    label=lambda size: f"{layers(size):,} layers in {size[1]} x {size[2]} pixels",
)  # fmt: skip
