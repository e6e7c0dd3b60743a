"""The rows that can be trained here, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from splatbench.methods import training
from splatbench.methods.reconstruction import Reconstruction
from splatbench.methods.run import Run
from splatbench.reference.errors import UsageError
from splatbench.reference.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Method:
    """One row of a leaderboard."""

    name: str
    settings: type
    """Frozen dataclass with a default for every field; all have `iterations`."""
    fit: Callable[[Scene, Any, Run], Reconstruction]
    """fit(scene, settings, run): train on scene.train_views only."""
    description: str
    """One line."""


METHODS: dict[str, Method] = {
    "3dgs": Method(
        name="3dgs",
        settings=training.Settings,
        fit=training.fit,
        description="3D Gaussian Splatting (Kerbl et al. 2023): SfM points, adaptive density "
        "control, opacity reset, SH warm-up, L1 + 0.2 D-SSIM",
    )
}


def get_method(name: str) -> Method:
    """The method of that name.

    Raises: UsageError, with the nearest name, if there is none.
    """
    if name not in METHODS:
        near = get_close_matches(name, METHODS, n=1, cutoff=0)[0]
        raise UsageError(
            f"method {name!r}: unknown, did you mean {near!r}? There are {', '.join(METHODS)}"
        )
    return METHODS[name]
