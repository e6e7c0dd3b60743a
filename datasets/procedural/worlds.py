"""The worlds by name, their presets, and making them."""

import importlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.datasets.procedural.plan import Plan, content_hash

WORLDS = {
    "courtyard": "courtyard",
    "city": "city",
    "aerial-sparse": "aerial",
    "tunnel": "tunnel",
    "street": "street",
}
"""World name to module of this package; each has PRESETS (name to Settings) and plan(seed, settings)."""


def _module(world: str) -> Any:
    if world not in WORLDS:
        raise UsageError(f"{world}: no such world; there are {', '.join(WORLDS)}")
    return importlib.import_module(f"splatproof.datasets.procedural.{WORLDS[world]}")


def settings_of(world: str, preset: str) -> Any:
    """The settings of a world's preset.

    Args:
        world: Name in WORLDS.
        preset: One of the world's presets.
    Raises: UsageError for an unknown one.
    """
    presets = _module(world).PRESETS
    if preset not in presets:
        raise UsageError(f"{preset}: {world} has no such preset; there are {', '.join(presets)}")
    return presets[preset]


def content(world: str, preset: str, seed: int) -> str:
    """Name of what a world's preset and seed make, as it stands in scene.toml.

    Args:
        world: Name in WORLDS.
        preset: One of the world's presets.
        seed: 0 or more.
    """
    return content_hash(world, asdict(settings_of(world, preset)), seed)


def plan(world: str, preset: str, seed: int) -> Plan:
    """The views of a world and what they see.

    Args:
        world: Name in WORLDS.
        preset: One of the world's presets.
        seed: 0 or more.
    """
    return _module(world).plan(seed, settings_of(world, preset))


def make(
    world: str, preset: str, seed: int, folder: Path, report: Any = lambda done, total: None
) -> Path:
    """Make a world in `folder`; a call that was stopped is continued by the next.

    Args:
        world: Name in WORLDS.
        preset: One of the world's presets.
        seed: 0 or more.
        folder: New, or this very scene.
        report: Told (steps done, steps in all), two steps a view.
    """
    from splatproof.datasets.procedural.exporting import make_scene

    if seed < 0:
        raise UsageError(f"seed is {seed}, expected 0 or more")
    return make_scene(plan(world, preset, seed), folder, report)
