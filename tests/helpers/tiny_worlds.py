"""Every procedural world in miniature."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest

from splatproof.base.locks import locked
from splatproof.datasets.procedural import (
    aerial,
    city,
    courtyard,
    exporting,
    street,
    tunnel,
    worlds,
)
from splatproof.datasets.procedural.plan import Plan

SMALL = {"width": 64, "height": 48, "samples": 1}
TINY = {
    "courtyard": courtyard.Settings(width=64, height=48, oblique=4, nadir=(2, 1), samples=2),
    "city": replace(city.PRESETS["small"], blocks=(2, 1), oblique=1, facade=2, cell=8.0, **SMALL),
    "aerial-sparse": replace(aerial.PRESETS["small"], tests=1, cell=12.0, **SMALL),
    "tunnel": replace(tunnel.PRESETS["small"], length=2.0, relit=1, **SMALL),
    "street": replace(street.PRESETS["small"], frames=4, shifted=1, columns=60, cell=8.0, **SMALL),
}


def plan(world: str, seed: int = 1):
    """The tiny world's plan; of the aerial scenes only two."""
    few = {kind: aerial.SCENES[kind] for kind in ("church", "park")}
    with patch.object(aerial, "SCENES", few):
        return worlds._module(world).plan(seed, TINY[world])


def made_once(
    world: str, what: Plan, config: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The world's folder, which all workers of pytest-xdist share. Leave it as it is."""
    root = tmp_path_factory.getbasetemp()
    if hasattr(config, "workerinput"):
        root = root.parent  # of this run of the tests, one level above that of this worker
    with locked(root / "worlds" / f"{world}.lock"):
        return exporting.make_scene(what, root / "worlds" / world)
