"""How fast this machine trains on the photos of a scene."""

import statistics
import time
from dataclasses import dataclass, replace

from splatproof.methods.auto.base import Base, prepare, started
from splatproof.methods.auto.spreading import evenly
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.resolution import Resolution
from splatproof.reference.types.scene import Scene

WARM, TIMED = 2, 7
"""Steps before the clock starts, and steps of which the median counts."""
VIEWS = 3
"""Photos that are trained on while the clock runs, spread evenly."""


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Wall seconds of a step: pixels and Gaussians each have their price."""

    pixels: float
    """Seconds that the pixels of a full-size view cost."""
    gaussian: float
    """Seconds that each Gaussian costs."""

    def step(self, gaussians: float, factor: float = 1.0) -> float:
        """Wall seconds of a step on one view.

        Args:
            gaussians: Number of Gaussians.
            factor: Factor by which the photo is shrunk.
        """
        return self.pixels / factor**2 + self.gaussian * gaussians


def measure(scene: Scene, settings: Settings, run: Run, base: Base = "3dgs") -> Speed:
    """Train a few steps at full and at half size from the start points; they are thrown away.

    Args:
        scene: With the points to start from.
        settings: What is trained.
        run: Threads and backend; its folder is not written to.
        base: What is trained. Photos of Gaussians that move cannot be shrunk, and the whole step is taken to go by
            the Gaussians: steps that turn out faster are added later, slower ones would have come too late.
    """
    explicit = "3dgs" if base == "stratosplat" else base  # whose points are all there
    scene = started(scene, replace(settings, dense_cell=0.0), run, explicit)
    if base == "pvg":
        swept = tuple(index for index in scene.train if scene.views[index].load_sweep is not None)
        few = replace(scene, train=evenly(swept, VIEWS))
        seconds, gaussians = _step(few, settings, run, 1.0, base)
        return Speed(pixels=0.0, gaussian=seconds / gaussians)
    few = replace(scene, train=evenly(scene.train, VIEWS))
    full, half = (_step(few, settings, run, factor, base)[0] for factor in (1.0, 2.0))
    pixels = min(full, max(0.0, (full - half) * 4 / 3))
    return Speed(pixels=pixels, gaussian=(full - pixels) / len(scene.points))


def _step(
    scene: Scene, settings: Settings, run: Run, factor: float, base: Base
) -> tuple[float, int]:
    """Median wall seconds of a step whose photos are shrunk by a factor, and the number of Gaussians."""
    settings = replace(
        settings, iterations=30_000, dense_cell=0.0,
        resolution=Resolution(coarsest=factor, full_from=1.0),
    )  # fmt: skip
    model, plan = prepare(scene, settings, run, base)
    trainer = Trainer(model, plan, replace(run, folder=None))
    times = []
    for index in range(WARM + len(scene.train) + TIMED):
        began = time.perf_counter()
        trainer.advance()
        if index >= WARM + len(scene.train):
            times.append((time.perf_counter() - began) / settings.views_per_step)
    return statistics.median(times), model.primitives
