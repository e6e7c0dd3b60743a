"""Flat ground that cameras look straight down on: what each of them sees is known by hand."""

from functools import partial

import torch
from torch import Tensor

from helpers.tiny_scene import sparse_points
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, SparsePoints, View

WIDTH, HEIGHT, FOCAL = 80, 60, 60.0
GROUND = 10.0
"""Depth of a plane that every camera looks down on."""


def looking_down(x: float, *, width: int = WIDTH) -> Camera:
    """A camera at (x, 0, 0) that looks along z: its image shows width / FOCAL x GROUND units of the plane."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = -x
    K = torch.tensor([[FOCAL, 0, width / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    return Camera(K=K.double(), world_to_camera=pose, width=width, height=HEIGHT)


def view(x: float, depth: Tensor | None = None) -> View:
    """A view of the plane, or of what `depth` says."""
    load = None if depth is None else partial(torch.clone, depth)
    return View(
        name=f"{x}",
        camera=looking_down(x),
        load=lambda: torch.zeros(HEIGHT, WIDTH, 3),
        load_depth=load,
    )


def plane_points(count: int = 400) -> SparsePoints:
    """Points of the plane, in nobody's track."""
    draw = torch.Generator().manual_seed(0)
    at = (torch.rand(count, 2, generator=draw, dtype=torch.float64) - 0.5) * 60
    positions = torch.cat([at, torch.full((count, 1), GROUND, dtype=torch.float64)], dim=1)
    return sparse_points(positions)


PLANE = torch.full((HEIGHT, WIDTH), GROUND)


def flat_scene(held_out: float, *training: float) -> Scene:
    """A view at `held_out` and training views beside it, with true depth and points."""
    views = tuple(view(x, PLANE) for x in (held_out, *training))
    return Scene(
        name="flat", root=None, views=views, train=tuple(range(1, len(views))), test=(0,),
        points=plane_points(), up=torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64), units="sfm",
        shift=torch.zeros(3, dtype=torch.float64),
    )  # fmt: skip
