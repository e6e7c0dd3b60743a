"""How long a case will take and how much memory, before it runs: right within a factor of two."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from splatbench.datasets.opening import open_scene
from splatbench.methods.run import Run
from splatbench.reference.errors import DataError
from splatbench.reference.result import Result
from splatbench.reference.scene import Scene
from splatbench.suites.environment import usable_cores
from splatbench.suites.records import RECORD_NAME, read_record
from splatbench.suites.suite_files import Case, Suite

START_SECONDS = 3.0
"""Imports of a case's process."""
PIXEL_STEP = 1.2e-6
"""CPU seconds a pixel of a training step: render, loss and gradients. Method 3dgs, native kernels,
one AVX-512 core: 0.9e-6 to 1.9e-6 from 180 x 180 to 500 x 280 px. Other methods cost other
multiples, which earlier records correct."""
GAUSSIAN_STEP = 0.5e-6
"""CPU seconds a Gaussian of a training step: projection, its gradients and Adam."""
PIXEL_SCORE = 6e-6
"""CPU seconds a pixel of a test view: metrics, error map, PNGs."""
GROWTH = 1.5
"""Gaussians while training, on average, as a multiple of the sparse points."""
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
    scenes = {key: open_scene(case.scene, case.protocol) for key, case in rows.items()}
    records = _records(folder / suite.name)
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
    gaussians = GROWTH * len(scene.points)
    train = _train_seconds(case.settings.iterations, _mean_pixels(scene), gaussians)
    images = min(Run.image_bytes, 12 * sum(_pixels(scene, i) for i in scene.train))
    largest = max((_pixels(scene, i) for i in (*scene.train, *scene.test)), default=0)
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


def _train_seconds(iterations: int, pixels: float, gaussians: float) -> float:
    return iterations * (pixels * PIXEL_STEP + gaussians * GAUSSIAN_STEP) / usable_cores()


def _ratio(record: Result, suite: Suite, scenes: dict[tuple[str, str], Scene]) -> list[float]:
    """Measured over modelled training seconds of a record; nothing if its scene is not open."""
    iterations = record.settings.get("iterations")
    names = {case.scene_name: case.scene for case in suite.cases}
    scene = scenes.get((names.get(record.scene, ""), record.protocol))
    if scene is None or not isinstance(iterations, int):
        return []
    modelled = _train_seconds(iterations, _mean_pixels(scene), GROWTH * len(scene.points))
    return [record.stages["train"] / modelled]


def _pixels(scene: Scene, index: int) -> int:
    camera = scene.views[index].camera
    return camera.width * camera.height


def _mean_pixels(scene: Scene) -> float:
    return statistics.fmean(_pixels(scene, i) for i in scene.train)


def _records(folder: Path) -> list[Result]:
    """The finished records below a folder; damaged ones are none."""
    found = []
    for path in sorted(folder.rglob(RECORD_NAME)):
        try:
            record = read_record(path.parent)
        except DataError:
            continue
        if not record.error:
            found.append(record)
    return found
