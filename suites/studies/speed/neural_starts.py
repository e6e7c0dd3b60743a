"""Scenes made in memory and methods in the middle of their training on them, all with equally many visible Gaussians."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.methods.anchors.control import AnchorDensity
from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs import fit as dlg_gs
from splatproof.methods.dlg_gs.settings import Settings as DlgSettings
from splatproof.methods.hdgs import fit as hdgs
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.hdgs.settings import Settings as HdgsSettings
from splatproof.methods.pvg import fit as pvg
from splatproof.methods.pvg.settings import MovingDensity, Start
from splatproof.methods.pvg.settings import Settings as PvgSettings
from splatproof.methods.scaffold import fit as scaffold
from splatproof.methods.scaffold.settings import Settings as ScaffoldSettings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import DepthPrior, Scene, SparsePoints, Sweep, View

STEP = 5_000
"""Where of 30,000 steps trainings stand: all harmonics are on, statistics are gathered."""
LATER = 14_000
"""Step from which density control changes anything: what is timed stays of one size."""
VIEWS = 8
TURN = 0.04
"""Angle in radians that the views' cameras, which share a centre, turn by in all."""
INSIDE = (0.06, 0.94)
"""Part of a view's width and height that its points lie in, so that all views show all of them."""
DISPARITIES = (0.1, 0.5)
"""Least and greatest inverse depth of the relief, one over scene units."""
EVERY = 5
"""One of so many rows is not to be seen: it is behind the cameras, or dead at the views' moments."""
SHOWN = 6
"""Slots of an anchor's ten that hold a Gaussian."""
PIXELS = (1.0, 4.0)
"""Standard deviations of Gaussians in pixels, log-uniform in between, as of the rasterizer's scenes."""
RETURNS = 5_000
"""Returns of each LiDAR sweep."""
DEAD = 50.0
"""Life peak of what is dead at the views' moments, far beyond the drive's end in either method's time."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """How much is drawn."""

    gaussians: int
    """About so many Gaussians are visible in every view."""
    width: int
    height: int


def relief(size: Size, draw: torch.Generator) -> Float[Tensor, "h w"]:
    """Smooth random inverse depths within DISPARITIES.

    Args:
        size: Width and height count.
        draw: Source of the draw.
    """
    low, high = DISPARITIES
    return low + (high - low) * _smooth(1, 4, size, draw)[0]


def _smooth(channels: int, cells: int, size: Size, draw: torch.Generator) -> Tensor:
    """Numbers in [0, 1] in so many channels, bilinear between the corners of so many cells."""
    coarse = torch.rand(1, channels, cells + 1, cells + 1, generator=draw)
    wide = (size.height, size.width)
    return functional.interpolate(coarse, size=wide, mode="bilinear", align_corners=True)[0]


def on_relief(
    disparity: Float[Tensor, "h w"], count: int, draw: torch.Generator
) -> Float[Tensor, "n 3"]:
    """Points drawn evenly over the image, on the relief but for 1 % of their depth; float64.

    Args:
        disparity: The relief, seen along z from the origin.
        count: Number of points.
        draw: Source of the draw.
    """
    height, width = disparity.shape
    low, high = INSIDE
    share = low + (high - low) * torch.rand(count, 2, generator=draw, dtype=torch.float64)
    at = share * torch.tensor([width, height])
    column, row = at.long().unbind(dim=1)
    rough = 1 + 0.01 * torch.randn(count, generator=draw, dtype=torch.float64)
    z = rough / disparity[row, column].double()
    away = (at - torch.tensor([width / 2, height / 2])) / focal(width)
    return torch.cat([away, torch.ones(count, 1)], dim=1) * z[:, None]


def focal(width: int) -> float:
    """Focal length in pixels."""
    return 0.9 * width


def scene(size: Size, points: int, *, behind: bool) -> Scene:
    """A relief in front of a camera that turns; views have all that any method reads.

    Args:
        size: Width and height of the views.
        points: Number of sparse points.
        behind: Whether every so many of the points are behind the cameras.
    """
    draw = torch.Generator().manual_seed(points + size.width)
    disparity = relief(size, draw)
    positions = on_relief(disparity, points, draw)
    if behind:
        positions[::EVERY] *= -1
    sky = torch.zeros(size.height, size.width, dtype=torch.bool)
    sky[: int(INSIDE[0] * size.height)] = True
    prior = DepthPrior(disparity=disparity, valid=~sky)
    views = tuple(_view(i, size, disparity, prior, sky, draw) for i in range(VIEWS))
    return Scene(
        name="relief", root=None, views=views, train=tuple(range(VIEWS)), test=(),
        points=SparsePoints(
            positions=positions,
            colours=torch.randint(256, (points, 3), generator=draw).to(torch.uint8),
            track_starts=torch.zeros(points + 1, dtype=torch.int64),
            track_views=torch.zeros(0, dtype=torch.int64),
        ),
        up=torch.tensor([0.0, -1, 0], dtype=torch.float64), units="metres",
        shift=torch.zeros(3, dtype=torch.float64),
    )  # fmt: skip


def _view(
    index: int, size: Size, disparity: Tensor, prior: DepthPrior, sky: Tensor, draw: torch.Generator
) -> View:
    """One of the views; what is measured of the relief is the same from all of them."""
    angle = TURN * (index / (VIEWS - 1) - 0.5)
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 0] = pose[2, 2] = math.cos(angle)
    pose[0, 2], pose[2, 0] = math.sin(angle), -math.sin(angle)
    length = focal(size.width)
    K = torch.tensor(
        [[length, 0, size.width / 2], [0, length, size.height / 2], [0, 0, 1]], dtype=torch.float64
    )
    camera = Camera(K=K, world_to_camera=pose, width=size.width, height=size.height)
    photo = _smooth(3, 40, size, draw).permute(1, 2, 0).contiguous()
    sweep = Sweep(positions=on_relief(disparity, RETURNS, draw).float(), origin=camera.centre)
    return View(
        name=f"{index}.png", camera=camera, load=photo.clone, time=0.1 * index,
        load_sky=sky.clone, load_prior=partial(replace, prior), load_sweep=partial(replace, sweep),
    )  # fmt: skip


def scaffold_gs(size: Size) -> Trainer:
    """Method scaffold-gs on the relief.

    Args:
        size: What is drawn.
    """
    settings = ScaffoldSettings(density=AnchorDensity(adjust_start=LATER))
    return anchored(partial(scaffold.prepare, settings=settings, run=Run()), size)


def dlg(size: Size) -> Trainer:
    """Method dlg-gs, all of it, on the same anchors.

    Args:
        size: What is drawn.
    """
    settings = DlgSettings(density=AnchorDensity(adjust_start=LATER))
    return anchored(partial(dlg_gs.prepare, settings=settings, run=Run()), size)


def anchored(prepare: Callable[[Scene], tuple[Model, Plan]], size: Size) -> Trainer:
    """A method of voxel anchors, a fifth of them out of view.

    Args:
        prepare: Makes model and plan.
        size: What is drawn.
    """
    anchors = math.ceil(size.gaussians / SHOWN) * EVERY // (EVERY - 1)
    model, plan = prepare(scene(size, anchors, behind=True))
    draw = torch.Generator().manual_seed(anchors)
    rows, shared = model.parameters.rows, model.parameters.shared
    for name in ("offsets", "features"):
        rows[name].normal_(generator=draw)
    # the shape network halves a Gaussian's scale where it says 0, as it does about everywhere at the start
    scales = 2 * in_units(
        pixels(rows["offsets"].shape[0], draw), centres_of(model.parameters), size
    )
    rows["log_scales"][:, 3:] = scales.log()
    holds = torch.arange(shared["opacity.bias1"].shape[0]) < SHOWN
    shared["opacity.weight1"] *= 0.05  # so that rounding does not decide which Gaussians there are
    shared["opacity.bias1"].copy_(torch.where(holds, 0.8, -0.8))
    return at_work(model, plan)


def moving(size: Size) -> tuple[Trainer, Trainer]:
    """Methods pvg and hdgs on one drive, a fifth of the rows dead; both draw as many Gaussians of one size.

    Args:
        size: What is drawn.
    """
    points = size.gaussians * EVERY // (EVERY - 1)
    drive = scene(size, points, behind=False)
    return of_pvg(drive, size, points), of_hdgs(drive, size, points)


def of_hdgs(drive: Scene, size: Size, most: int) -> Trainer:
    """Method hdgs.

    Args:
        drive: What it is trained on.
        size: What is drawn.
        most: Most Gaussians of all anchors, dead ones too.
    """
    settings = HdgsSettings(density=HdgsDensity(interval=LATER), from_sweeps=False)
    settings = replace(settings, anchors=max(EVERY, most // settings.gaussians))
    model, plan = hdgs.prepare(drive, settings, Run())
    rows, frame = model.parameters.rows, model.frame
    centres = frame.outwards(model.parameters.labels["centres"])
    draw = torch.Generator().manual_seed(len(centres))
    scales = 2 * in_units(pixels(len(centres), draw), centres, size) / frame.unit  # as above
    rows["log_scales"].copy_(scales.log())
    rows["peaks"][::EVERY] = DEAD
    rows["log_spans"][::EVERY] = math.log(settings.moving_span)
    return at_work(model, plan)


def of_pvg(drive: Scene, size: Size, most: int) -> Trainer:
    """Method pvg.

    Args:
        drive: What it is trained on.
        size: What is drawn.
        most: Number of Gaussians, dead ones too.
    """
    settings = PvgSettings(
        density=MovingDensity(start=LATER, reset_interval=0), start=Start(sweep_points=0),
        initial_opacity=0.5,
    )  # fmt: skip
    model, plan = pvg.prepare(drive, settings, Run())
    rows = model.parameters.rows
    draw = torch.Generator().manual_seed(most)
    rows["log_scales"].copy_(in_units(pixels(most, draw), rows["means"], size).log())
    rows["sh_rest"].normal_(std=0.05, generator=draw)
    rows["peaks"][::EVERY] = DEAD
    rows["log_spans"][::EVERY] = math.log(settings.start.moving_span)
    return at_work(model, plan)


def pixels(count: int, draw: torch.Generator) -> Float[Tensor, "n 3"]:
    """Standard deviations in pixels.

    Args:
        count: Number of Gaussians or anchors.
        draw: Source of the draw.
    """
    low, high = (math.log(each) for each in PIXELS)
    return (low + (high - low) * torch.rand(count, 3, generator=draw)).exp()


def in_units(
    sizes: Float[Tensor, "n 3"], positions: Float[Tensor, "n 3"], size: Size
) -> Float[Tensor, "n 3"]:
    """Pixels at a place in scene units.

    Args:
        sizes: In pixels.
        positions: Where, in front of the cameras or behind.
        size: Width counts.
    """
    return sizes * positions[:, 2:].abs().float() / focal(size.width)


def at_work(model: Model, plan: Plan) -> Trainer:
    """The trainer before a step in the middle.

    Args:
        model: What is trained.
        plan: How.
    """
    trainer = Trainer(model, plan, Run())
    trainer.step = STEP
    return trainer
