"""A scene of a few tiny photos that has all that any method reads, and points that no one would wish for."""

from dataclasses import replace
from functools import cache, partial

import torch
from torch import Tensor

from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import DepthPrior, Scene, SparsePoints, Sweep, View

WIDTH, HEIGHT, VIEWS, BLOBS = 24, 18, 6, 30
DIRECTION = (0.6, -0.48, 0.64)
"""Unit vector along no axis: where far scenes lie."""
FAR_POINT = 50.0
"""Distance of a wrong point from the others, ten times the scene's depth."""

GREY = 0.2
"""Behind the blobs. Nothing is quite black or white: there rounding decides whether a colour that is cut at 0
gets a gradient."""


def nasty_scene(distance: float = 0.0) -> Scene:
    """Photos of blobs from a row of cameras that look along z, up is -z; each has time, sky, sweep, prior.

    Its points are the blobs' centres, three of them twice, and wrong ones: behind the cameras, in a camera's
    centre, far beside. View 0 is held out.

    Args:
        distance: How far from the origin all of it lies, scene units; 0: cameras stand at z = 0.
    """
    means, views = _photographed()
    wrong = torch.tensor(
        [[0.1, 0.2, -1.0], [-0.2, 0.1, -2.0], [0.0, 0.0, -0.5], [FAR_POINT, 0, 4], [0, 0, 0]]
    )
    wrong[-1] = views[2].camera.centre.float()
    scene = Scene(
        name="nasty", root=None, views=views, train=tuple(range(1, VIEWS)), test=(0,),
        points=_tracked(torch.cat([means, means[:3], wrong]).double(), views),
        up=torch.tensor([0.0, 0, -1], dtype=torch.float64), units="metres",
        shift=torch.zeros(3, dtype=torch.float64),
    )  # fmt: skip
    return moved(scene, distance * torch.tensor(DIRECTION, dtype=torch.float64))


@cache
def _photographed() -> tuple[Tensor, tuple[View, ...]]:
    """The blobs' centres, and their photos; nobody changes either."""
    draw = torch.Generator().manual_seed(0)
    low, wide = torch.tensor([-1.5, -1.0, 3.0]), torch.tensor([3.0, 2.0, 2.0])
    means = low + wide * torch.rand(BLOBS, 3, generator=draw)
    blobs = {
        "quaternions": torch.randn(BLOBS, 4, generator=draw),
        "scales": 0.1 + 0.3 * torch.rand(BLOBS, 3, generator=draw),
        "opacities": 0.3 + 0.6 * torch.rand(BLOBS, generator=draw),
        "sh": 0.4 * torch.randn(BLOBS, 4, 3, generator=draw),
    }
    return means, tuple(_view(index, means, blobs) for index in range(VIEWS))


def _view(index: int, means: Tensor, blobs: dict[str, Tensor]) -> View:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([0.3 * index - 0.75, 0.1 * index - 0.25, 0.0])
    K = [[1.2 * WIDTH, 0, WIDTH / 2], [0, 1.2 * WIDTH, HEIGHT / 2], [0, 0, 1]]
    camera = Camera(
        K=torch.tensor(K, dtype=torch.float64), world_to_camera=pose, width=WIDTH, height=HEIGHT
    )
    seen = rasterizer.rasterize(
        camera, means, blobs["quaternions"], blobs["scales"], blobs["opacities"], sh=blobs["sh"],
        background=torch.full((3,), GREY),
    )  # fmt: skip
    time = 0.1 * index
    return View(
        name=f"{index}.png", camera=camera, load=partial(torch.clone, seen.colour.clamp(0, 1)), time=time,
        load_sky=partial(torch.clone, seen.alpha < 0.01), load_prior=partial(_prior, seen),
        load_sweep=partial(Sweep, positions=means.clone(), origin=camera.centre, time=time),
    )  # fmt: skip


def _prior(seen: RenderOutput) -> DepthPrior:
    """True disparity in a scale and with a zero of its own."""
    valid = seen.alpha > 0.1
    return DepthPrior(disparity=3 / seen.depth.clamp(min=0.5) + 0.4, valid=valid)


def _tracked(positions: Tensor, views: tuple[View, ...]) -> SparsePoints:
    """Points seen by the views they land in; wrong ones by the first two, as a wrong match has it."""
    inside = []
    for view in views:
        pixels, depths = project_points(view.camera, positions)
        size = pixels.new_tensor([view.camera.width, view.camera.height])
        inside.append((depths > 0) & ((pixels >= 0) & (pixels < size)).all(dim=1))
    seen = torch.stack(inside, dim=1)
    seen[~seen.any(dim=1), :2] = True
    draw = torch.Generator().manual_seed(1)
    colours = torch.randint(1, 255, (len(positions), 3), generator=draw)
    return SparsePoints(
        positions=positions, colours=colours.to(torch.uint8), track_views=seen.nonzero()[:, 1],
        track_starts=torch.cat([torch.zeros(1).long(), seen.sum(dim=1).cumsum(0)]),
    )  # fmt: skip


def moved(scene: Scene, shift: Tensor) -> Scene:
    """The same scene elsewhere: its cameras, points and sweeps.

    Args:
        scene: Scene that is left as it is.
        shift: Added to all positions, float64, scene units.
    """

    def elsewhere(view: View) -> View:
        pose = view.camera.world_to_camera.clone()
        pose[:3, 3] -= pose[:3, :3] @ shift
        load = view.load_sweep
        assert load is not None

        def sweep() -> Sweep:
            held = load()
            positions = (held.positions.double() + shift).float()
            return replace(held, positions=positions, origin=held.origin + shift)

        return replace(view, camera=replace(view.camera, world_to_camera=pose), load_sweep=sweep)

    points = replace(scene.points, positions=scene.points.positions + shift)
    return replace(scene, views=tuple(map(elsewhere, scene.views)), points=points)
