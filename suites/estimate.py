"""How long a case will take and how much memory, before it runs: right within a factor of two."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.typed_toml import build
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.registry import get_method, methods
from splatproof.reference.types.result import Result
from splatproof.reference.types.scene import Scene
from splatproof.suites.environment import usable_cores
from splatproof.suites.records import read_finished
from splatproof.suites.suite_files import Case, Suite

START_SECONDS = 3.0
"""Wall seconds of the imports of a case's process."""
PIXEL_SCORE = 6e-6
"""CPU seconds a pixel of a test view: metrics, error map, PNGs."""


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

    Where <folder>/<suite> holds finished records of the same method and backend, the method's own
    estimate is multiplied by the median of measured over stated seconds.

    Args:
        suite: The suite; its scenes must be on this machine.
        folder: Folder of the runs, with the suites' folders.
        backend: Name of the rasterizer.
    """
    rows = {(case.scene, case.protocol.name): case for case in suite.cases}
    scenes = {key: open_scene(case.scene, case.protocol) for key, case in rows.items()}
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
    """What the method itself says that it takes, over the cores, and the scoring.

    Args:
        case: Method and settings.
        scene: Opened under the case's protocol.
        backend: Name of the rasterizer; methods state the cost of "cpu" only.
        ratios: Measured over stated training seconds of earlier cases.
    Raises: UsageError where the method's cost fails or is none.
    """
    factor = statistics.median(ratios) if ratios else 1.0
    stated = _stated(get_method(case.method), case.settings, scene)
    score = sum(_pixels(scene, i) for i in scene.test) * PIXEL_SCORE / usable_cores()
    basis = "the method's own estimate"
    if ratios:
        basis = f"the method's estimate x {factor:.2g} from {len(ratios)} earlier cases"
    elif backend != "cpu":
        basis = "the method's estimate for backend cpu: not known for this one"
    return Estimate(
        seconds=START_SECONDS + factor * stated.cpu_seconds / usable_cores() + score,
        memory_mb=stated.memory_mb,
        basis=basis,
    )


def _ratio(record: Result, suite: Suite, scenes: dict[tuple[str, str], Scene]) -> list[float]:
    """Measured over stated training seconds of a record; nothing if its scene is not open, or its
    settings are not those of today."""
    names = {case.scene_name: case.scene for case in suite.cases}
    scene = scenes.get((names.get(record.scene, ""), record.protocol))
    method = methods().get(record.method)
    if scene is None or method is None:
        return []
    try:
        settings = build(method.settings, record.settings, "record")
    except UsageError:
        return []
    stated = _stated(method, settings, scene).cpu_seconds / usable_cores()
    return [record.training_seconds / stated] if stated > 0 else []


def _stated(method: Method, settings: Any, scene: Scene) -> Cost:
    """What the method says. Raises: UsageError naming the method where it can say nothing of use."""
    try:
        stated = method.cost(settings, scene)
        if not (stated.cpu_seconds >= 0 and stated.memory_mb >= 0):
            raise ValueError(f"{stated}, expected 0 or more")
    except SplatproofError:
        raise
    except Exception as error:  # a method that is not ours may raise anything
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(f"method {method.name}: its cost fails ({said}); mend it") from error
    return stated


def _pixels(scene: Scene, index: int) -> int:
    camera = scene.views[index].camera
    return camera.width * camera.height
