"""The worlds in miniature, made once in a run of the tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import tiny_worlds
from splatproof.base.locks import locked
from splatproof.datasets.procedural import exporting
from splatproof.datasets.procedural.plan import Plan


@pytest.fixture(scope="session")
def made(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Callable[[str], tuple[Path, Plan]]:
    """Gives a world's folder and plan; workers of pytest-xdist share the folders. Leave them as they are."""
    root, plans = tmp_path_factory.getbasetemp(), {}
    if hasattr(request.config, "workerinput"):
        root = root.parent  # of this run of the tests, one level above that of this worker

    def get(world: str) -> tuple[Path, Plan]:
        if world not in plans:
            plans[world] = tiny_worlds.plan(world)
        with locked(root / "worlds" / f"{world}.lock"):
            return exporting.make_scene(plans[world], root / "worlds" / world), plans[world]

    return get
