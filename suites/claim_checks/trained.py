"""Short fits that checks look at."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.contracts.reconstruction import ARRAYS, Origin, Reconstruction, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene

SCENE, PROTOCOL = "courtyard", "quick"
DENSITY = {"density": StrategicDensity(least_interval=10)}
"""Settings of 3dgs by which something is densified in runs as short as these."""
SETTINGS: dict[str, dict[str, Any]] = {"3dgs": DENSITY, "scaffold-gs": {}}


@functools.cache
def scene() -> Scene:
    """A small scene that every machine can make."""
    return open_scene(SCENE, load_protocol(PROTOCOL))


def fit(
    method: str, steps: int, run: Run, special: Mapping[str, Any] | None = None
) -> Reconstruction:
    """A fit of so many steps.

    Args:
        method: Name of a method.
        steps: Number of its steps.
        run: Seed, threads, and where checkpoints go.
        special: Settings that are not the method's own; None: those of SETTINGS.
    """
    chosen = get_method(method)
    own = SETTINGS.get(method, {}) if special is None else special
    settings = chosen.settings(iterations=steps, **own)
    return chosen.fit(scene().for_training(), settings, run)


def stored(model: Reconstruction, folder: Path) -> bytes:
    """The bytes of a model's arrays as they are saved.

    Args:
        model: What is saved.
        folder: Where to; made where it is missing.
    """
    save_model(model, folder, Origin(method="check"))
    return (folder / ARRAYS).read_bytes()
