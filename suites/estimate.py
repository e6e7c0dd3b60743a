"""How long a case will take and how much memory, before it runs: right within a factor of two."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.run import Run
from splatproof.methods.training.initialise import with_random_points
from splatproof.reference.types.result import Result
from splatproof.reference.types.scene import Scene
from splatproof.suites.environment import usable_cores
from splatproof.suites.records import read_finished
from splatproof.suites.suite_files import Case, Suite

START_SECONDS = 3.0
"""Imports of a case's process."""
PIXEL_STEP = 0.1e-6
"""CPU seconds a pixel of a training step: loss and what compositing costs beside the Gaussians. This
and GAUSSIAN_STEP fit 1000 and 2000 iterations of 3dgs at 240 px on two scenes, native kernels,
AVX-512 at 2.6 GHz, to 25 %. Earlier records correct them for other methods and machines."""
GAUSSIAN_STEP = 0.42e-6
"""CPU seconds a Gaussian of a training step: projection, compositing, gradients and Adam."""
PIXEL_SCORE = 6e-6
"""CPU seconds a pixel of a test view: metrics, error map, PNGs."""
GROWTH_STEPS, GROWTH_MOST = 300, 15.0
"""The mean number of Gaussians grows by the number of sparse points every so many steps, up to this
multiple of it (3.4 to 4.2 measured at 1000 steps, 8.5 to 13 at 2000). At the end it is twice that."""
BASE_MB = 400.0
"""Python, torch and the other libraries, with torch's pools."""
GAUSSIAN_BYTES = 59 * 4 * 8
"""Parameters, gradients, Adam's moments and temporaries of a Gaussian of degree 3."""
PIXEL_BYTES = 800
"""Images and temporaries of a training step, a pixel."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """What a case will probably cost."""

    seconds: float
    """Wall seconds of the whole case."""
    memory_mb: float
    """Peak memory of its process in 2^20 bytes."""
    basis: str
    """What the numbers rest on."""


def estimate_suite(suite: Suite, folder: Path, backend: str) -> list[Estimate]:
    """One estimate a case, in the suite's order. Scenes are opened; no image is read.

    Where <folder>/<suite> holds finished records of the same method and backend, the model's
    training time is multiplied by the median of measured over modelled.

    Args:
        suite: Its scenes must be on this machine.
        folder: Of the runs.
        backend: Name of the rasterizer.
    """
    rows = {(case.scene, case.protocol.name): case for case in suite.cases}
    scenes = {
        # a scene without points costs what the random ones do that it starts from
        key: with_random_points(
            open_scene(case.scene, case.protocol), getattr(case.settings, "random_points", 0), 0
        )
        for key, case in rows.items()
    }
    records = read_finished(folder / suite.name)
    estimates = []
    for case in suite.cases:
        ratios = [
            ratio
            for record in records
            if (record.method, record.environment.get("backend")) == (case.method, backend)
            for ratio in _ratio(record, suite, scenes)
        ]
        scene = scenes[case.scene, case.protocol.name]
        estimates.append(estimate(case, scene, backend, ratios))
    return estimates


def estimate(case: Case, scene: Scene, backend: str, ratios: Sequence[float] = ()) -> Estimate:
    """The model: iterations x (pixels x PIXEL_STEP + Gaussians x GAUSSIAN_STEP) over the cores.

    Args:
        case: With `iterations` in its settings.
        scene: Opened under the case's protocol.
        backend: Name of the rasterizer; the model knows only "cpu".
        ratios: Measured over modelled training seconds of earlier cases.
    """
    factor = statistics.median(ratios) if ratios else 1.0
    score = sum(_pixels(scene, i) for i in scene.test) * PIXEL_SCORE / usable_cores()
    settings = asdict(case.settings)
    train = _train_seconds(settings, scene)
    images = min(Run.image_bytes, 12 * sum(_pixels(scene, i) for i in scene.train))
    largest = max((_pixels(scene, i) for i in (*scene.train, *scene.test)), default=0)
    gaussians = 2 * _mean_gaussians(settings["iterations"], scene)
    extra = images + gaussians * GAUSSIAN_BYTES + largest * PIXEL_BYTES
    basis = "model"
    if ratios:
        basis = f"model x {factor:.2g} from {len(ratios)} earlier cases"
    elif backend != "cpu":
        basis = "model of backend cpu: not known for this one"
    return Estimate(
        seconds=START_SECONDS + factor * train + score,
        memory_mb=BASE_MB + extra / 2**20,
        basis=basis,
    )


def _train_seconds(settings: Mapping[str, Any], scene: Scene) -> float:
    """Of a model in one piece, or of a city: a coarse model if any, and K blocks that share the
    Gaussians, each in a process of its own."""
    pixels = statistics.fmean(_pixels(scene, i) for i in scene.train) * PIXEL_STEP
    steps, blocks = settings["iterations"], settings.get("blocks", 1)
    gaussians = _mean_gaussians(steps, scene) * GAUSSIAN_STEP
    start = START_SECONDS * blocks if blocks > 1 else 0.0
    coarse = settings.get("coarse_iterations", 0)
    work = blocks * steps * (pixels + gaussians / blocks) + coarse * (pixels + gaussians)
    return (settings.get("views_per_step", 1) * work + start) / usable_cores()


def _mean_gaussians(iterations: int, scene: Scene) -> float:
    return len(scene.points) * min(1 + iterations / GROWTH_STEPS, GROWTH_MOST)


def _ratio(record: Result, suite: Suite, scenes: dict[tuple[str, str], Scene]) -> list[float]:
    """Measured over modelled training seconds of a record; nothing if its scene is not open."""
    names = {case.scene_name: case.scene for case in suite.cases}
    scene = scenes.get((names.get(record.scene, ""), record.protocol))
    if scene is None or not isinstance(record.settings.get("iterations"), int):
        return []
    return [record.training_seconds / _train_seconds(record.settings, scene)]


def _pixels(scene: Scene, index: int) -> int:
    camera = scene.views[index].camera
    return camera.width * camera.height
