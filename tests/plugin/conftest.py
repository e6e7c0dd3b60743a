"""A project of somebody else: a method, a suite of it on a tiny scene, and tests."""

from pathlib import Path

import pytest

from helpers import colmap_scenes
from splatproof.suites import held_out
from splatproof.suites.workers import in_process
from splatproof.testing import items, runs

METHOD = '''
"""Method painted: Gaussians at the sparse points, their colours a little off by the seed."""

from dataclasses import dataclass, replace

import torch

from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import METHODS
from splatproof.methods.training.initialise import from_points

WRONG = 0.0
FAILS = False


@dataclass(frozen=True, kw_only=True)
class Settings:
    """None."""

    noise: float = 0.01
    """Of the colours."""


def fit(scene, settings, run):
    """Place them."""
    if FAILS:
        raise ValueError("not today")
    start = from_points(scene, degree=0, opacity=0.9)
    drawn = torch.randn(start.sh.shape, generator=torch.Generator().manual_seed(run.seed))
    sh = start.sh + settings.noise * drawn + WRONG
    return ExplicitModel(
        model=replace(start, sh=sh), shift=scene.shift, units=scene.units, backend=run.backend
    )


METHODS["painted"] = Method(
    name="painted", settings=Settings, fit=fit, description="Places points",
    cost=lambda settings, scene: Cost(cpu_seconds=1.0, memory_mb=1.0),
)
'''
SUITE = """
description = "Painted points"
[[cases]]
scenes = ["./scene"]
methods = ["painted"]
protocols = ["./half.toml"]
seeds = [0, 1, 2]
"""
PROTOCOL = 'source = "ours"\nhold = 2\nmetrics = ["psnr", "ssim_3dgs"]\n'


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of a few photos of 96 x 72 pixels."""
    folder = tmp_path_factory.mktemp("tiny") / "scene"
    colmap_scenes.write_scene(folder, colmap_scenes.Flight(views=8))
    return folder


@pytest.fixture
def project(pytester: pytest.Pytester, tiny: Path, monkeypatch: pytest.MonkeyPatch):
    """The project; its cases run in this process, which saves seconds of imports each."""
    assert items.Runs is runs.Runs  # loaded before: pytester forgets what is loaded in a test
    monkeypatch.setattr(runs, "in_worker", in_process)
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)
    (pytester.path / "scene").symlink_to(tiny)
    (pytester.path / "mine.splat.toml").write_text(SUITE)
    (pytester.path / "half.toml").write_text(PROTOCOL)
    (pytester.path / "painted.py").write_text(METHOD)
    pytester.makeconftest("import painted")
    pytester.syspathinsert()
    pytester.makeini("[pytest]\naddopts = --strict-markers -p no:cacheprovider")
    return pytester


@pytest.fixture
def changed(project: pytest.Pytester):
    """Change the method's code: changed("WRONG = 0.0", "WRONG = 0.5")."""

    def change(old: str, new: str) -> None:
        file = project.path / "painted.py"
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))

    return change
