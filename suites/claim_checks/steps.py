"""Whole training steps of methods whose Gaussians are decoded or move: milliseconds, and ratios in turns."""

import statistics
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch

from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.methods.scaffold.fit import prepare as scaffold
from splatproof.methods.scaffold.settings import Settings as ScaffoldSettings
from splatproof.methods.training.loop import Trainer
from splatproof.reference.types.scene import Scene, SparsePoints, View
from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.studies.speed import neural_starts as starts
from splatproof.suites.studies.speed.neural import FULL, SMALL
from splatproof.suites.studies.speed.neural_starts import Size
from splatproof.suites.twins.random_scenes import speed_scene

WARM, TURN, TURNS = 60, 10, 11
"""Steps before the first that counts; steps of a turn; turns of each."""
QUICK_WARM, QUICK_TURN, QUICK_TURNS = 2, 1, 3
"""The same of the reduced form."""
ANCHORS, WIDTH, HEIGHT = 19_800, 400, 300
"""Anchors, each in its own voxel, of which somewhat more than half of the Gaussians are decoded, and the image."""
QUICK_ANCHORS = 300


def anchored(count: int) -> Scene:
    """One photo of random Gaussians, and their centres as the points to start from.

    Args:
        count: Number of Gaussians.
    """
    drawn, _ = speed_scene(count, WIDTH, HEIGHT)
    with torch.no_grad():
        model = drawn.arguments(torch.float32)
        photo = rasterize(drawn.camera, *model[:4], sh=model[4]).colour.clamp(0, 1)
    view = View(name="0.png", camera=drawn.camera, load=partial(torch.clone, photo))
    colours = torch.full((count, 3), 128, dtype=torch.uint8)
    points = SparsePoints(
        positions=drawn.means.double(), colours=colours,
        track_starts=torch.arange(count + 1), track_views=torch.zeros(count).long(),
    )  # fmt: skip
    return Scene(
        name="random", root=None, views=(view,), train=(0,), test=(), points=points,
        up=torch.tensor([0.0, 0.0, 1.0]).double(), units="metres", shift=torch.zeros(3).double(),
    )  # fmt: skip


def turns(trainers: Sequence[Trainer], *, reduced: bool) -> list[tuple[float, ...]]:
    """Milliseconds a step of each trainer, a turn a row; what else the machine does meets all.

    Args:
        trainers: Runs that are far from their first densification.
        reduced: Fewer and shorter turns.
    """
    warm, turn = (QUICK_WARM, QUICK_TURN) if reduced else (WARM, TURN)
    for trainer in trainers:
        for _ in range(warm):
            trainer.advance()
    return [
        tuple(_milliseconds(trainer, turn) for trainer in trainers)
        for _ in range(QUICK_TURNS if reduced else TURNS)
    ]


def _milliseconds(trainer: Trainer, steps: int) -> float:
    began = time.perf_counter()
    for _ in range(steps):
        trainer.advance()
    return 1e3 * (time.perf_counter() - began) / steps


def scaffold_step(reduced: bool, folder: Path) -> Measurement:
    """Milliseconds of a step of scaffold-gs.

    Args:
        reduced: Fewer anchors, fewer steps.
        folder: Not written to.
    """
    del folder
    scene = anchored(QUICK_ANCHORS if reduced else ANCHORS)
    model, plan = scaffold(scene, ScaffoldSettings(voxel=1e-4), Run())
    trainer = Trainer(model, plan, Run())
    found = turns([trainer], reduced=reduced)
    with torch.no_grad():
        decoded = len(model.splats(scene.views[0], TRAINED))
    return Measurement(
        values=tuple(one for (one,) in found),
        compared=f"{decoded:,} Gaussians decoded of {len(model.parameters):,} anchors, {WIDTH}x{HEIGHT}",
    )


def dlg_over_scaffold(reduced: bool, folder: Path) -> Measurement:
    """How many times as long a step of dlg-gs takes as one of scaffold-gs, from the same anchors.

    Args:
        reduced: Fewer Gaussians, fewer steps.
        folder: Not written to.
    """
    del folder
    size = SMALL if reduced else FULL
    both = [starts.dlg(size), starts.scaffold_gs(size)]
    return _ratio("dlg-gs over scaffold-gs", size, both, reduced=reduced)


def hdgs_over_pvg(reduced: bool, folder: Path) -> Measurement:
    """How many times as long a step of hdgs takes as one of pvg, on one drive.

    Args:
        reduced: Fewer Gaussians, fewer steps.
        folder: Not written to.
    """
    del folder
    size = SMALL if reduced else FULL
    by_itself, anchored_ones = starts.moving(size)
    return _ratio("hdgs over pvg", size, [anchored_ones, by_itself], reduced=reduced)


def _ratio(compared: str, size: Size, both: Sequence[Trainer], *, reduced: bool) -> Measurement:
    found = turns(both, reduced=reduced)
    first, second = (statistics.median(column) for column in zip(*found, strict=True))
    return Measurement(
        values=tuple(one / other for one, other in found),
        compared=f"{compared}, about {size.gaussians:,} Gaussians, {size.width}x{size.height}: {first:.3g} and "
        f"{second:.3g} ms a step, in turns in one process",
    )


STEPS = {
    "scaffold_step": Check(measure=scaffold_step, unit="ms", seconds=(12.0, 2.0)),
    "dlg_step": Check(measure=dlg_over_scaffold, unit="times", seconds=(35.0, 4.0)),
    "hdgs_step": Check(measure=hdgs_over_pvg, unit="times", seconds=(25.0, 4.0)),
}
