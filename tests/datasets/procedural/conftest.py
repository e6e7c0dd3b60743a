"""The worlds in miniature, made once in a run of the tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import tiny_worlds
from splatproof.datasets.procedural.plan import Plan


@pytest.fixture(scope="session")
def made(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Callable[[str], tuple[Path, Plan]]:
    """Gives a world's folder and plan; workers of pytest-xdist share the folders. Leave them as they are."""
    plans = {}

    def get(world: str) -> tuple[Path, Plan]:
        if world not in plans:
            plans[world] = tiny_worlds.plan(world)
        return tiny_worlds.made_once(world, plans[world], request.config, tmp_path_factory), plans[
            world
        ]

    return get
