"""Snapshots of a model in training: they can be drawn, and change nothing."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.small_runs import digest
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.pvg.settings import Start
from splatproof.methods.registry import get_method
from splatproof.methods.training import snapshots
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.snapshots import SNAPSHOT, Snapshots, read_snapshot
from splatproof.reference.types.scene import Scene

RUNS = {
    "3dgs": {"iterations": 20},
    "3dgs with exposures": {"iterations": 20, "exposure": "affine"},
    "scaffold-gs": {"iterations": 20},
    "dlg-gs": {"iterations": 20, "vdjc": "off"},
    "pvg": {
        "iterations": 20,
        "lidar": LidarSettings(weight=0.0),
        "sky": SkySettings(weight=0.0),
        "start": Start(sweep_points=0),
    },
}


def timed_scene() -> Scene:
    """The tiny scene, a view every half a second."""
    scene = tiny_scene()
    views = tuple(replace(view, time=0.5 * i) for i, view in enumerate(scene.views))
    return replace(scene, views=views)


def fitted(name: str, folder: Path, **more) -> Reconstruction:
    method = get_method(name.split()[0])
    run = Run(threads=1, seed=1, **more)
    return method.fit(timed_scene().for_training(), method.settings(**RUNS[name]), run)


def hashed(model: Reconstruction, folder: Path) -> str:
    folder.mkdir()
    return digest(dict(model.store(folder).tensors))


@pytest.mark.parametrize("name", RUNS)
def test_a_watched_training_ends_in_the_same_bytes(name: str, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(snapshots, "EVERY_SECONDS", 0.0)
    monkeypatch.setattr(snapshots, "SHARE", float("inf"))  # one at each call
    watched = fitted(name, tmp_path, on_model=Snapshots(tmp_path))
    alone = fitted(name, tmp_path)
    assert hashed(watched, tmp_path / "a") == hashed(alone, tmp_path / "b")
    step, total, model = read_snapshot(tmp_path)
    assert (step, total) == (20, 20)
    scene = timed_scene()
    drawn = DecodedModel.of("in training", model, scene, "cpu")
    for view in (scene.views[0], scene.views[2]):
        assert torch.equal(drawn.render(view).colour, watched.render(view).colour)


def test_another_seed_is_seen(tmp_path: Path):
    method = get_method("scaffold-gs")
    settings = method.settings(**RUNS["scaffold-gs"])
    fits = [
        method.fit(timed_scene().for_training(), settings, Run(threads=1, seed=seed))
        for seed in (1, 2)
    ]
    assert hashed(fits[0], tmp_path / "a") != hashed(fits[1], tmp_path / "b")


def test_snapshots_take_a_hundredth_of_the_time(tmp_path: Path, monkeypatch):
    now, written = [0.0], []
    monkeypatch.setattr(snapshots.time, "monotonic", lambda: now[0])

    def write(path: Path, data: bytes) -> None:
        assert path == tmp_path / SNAPSHOT
        written.append(now[0])
        now[0] += 0.5  # a large model on a slow disk

    monkeypatch.setattr(snapshots, "write_bytes", write)
    monkeypatch.setattr(snapshots, "pickled", lambda value: b"")
    model = GaussianModel(random_gaussians(3), Rates(), extent=1.0)
    told = Snapshots(tmp_path)
    for step in range(1, 2001):
        now[0] += 0.1
        told(step, 2000, model)
    assert len(written) == 5  # at once, then every 50.5 s of 200, and the last step
    assert now[0] == pytest.approx(200 + 0.5 * len(written))
