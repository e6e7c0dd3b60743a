"""A model is shown while it trains."""

import json
import time
from pathlib import Path

import pytest

from helpers.colmap_scenes import Flight, write_scene
from helpers.local_requests import ask
from helpers.tiny_scene import tiny_scene
from splatproof.cli import main
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method
from splatproof.methods.training import snapshots
from splatproof.methods.training.snapshots import Snapshots
from splatproof.metrics.protocol_files import load_protocol
from splatproof.viewing.live import newest, watched
from splatproof.viewing.stage import Stage


def test_a_snapshot_knows_its_step(tmp_path: Path):
    method = get_method("3dgs")
    scene, snapshots_of = tiny_scene(), Snapshots(tmp_path)
    method.fit(
        scene.for_training(), method.settings(iterations=10), Run(threads=1, on_model=snapshots_of)
    )
    shown = newest(tmp_path, scene, "m")
    assert (shown.step, shown.steps, shown.model.primitives) == (10, 10, 40)
    assert Stage((shown,), scene).place.radius > 0


def test_the_page_shows_newer_snapshots(tmp_path: Path, monkeypatch):
    """A process of its own serves the folder, and ends with the block."""
    write_scene(tmp_path / "scene", Flight())
    monkeypatch.setattr(snapshots, "EVERY_SECONDS", 0.0)
    monkeypatch.setattr(snapshots, "SHARE", float("inf"))
    method, told = get_method("3dgs"), []
    with watched(str(tmp_path / "scene"), load_protocol("default"), "mine", told.append) as folder:
        port = int(told[0].split(":")[-1].strip("/"))
        for steps in (10, 20):
            method.fit(
                tiny_scene().for_training(), method.settings(iterations=steps),
                Run(threads=1, on_model=Snapshots(folder)),
            )  # fmt: skip
            until = time.monotonic() + 120
            while (model := _shown(port))["step"] != steps:
                assert time.monotonic() < until
                time.sleep(0.2)
            assert (model["name"], model["steps"]) == ("mine", steps)
    assert not folder.exists()
    with pytest.raises(OSError, match="refused"):
        ask(port, "/state.json")


def _shown(port: int) -> dict:
    return json.loads(ask(port, "/state.json").text)["models"][0]


def test_methods_in_blocks_are_not_watched(capsys):
    assert main(["fit", "stitchgs", "courtyard", "--out", "x", "--view"]) == 2
    told = capsys.readouterr().err
    assert "stitchgs trains blocks in processes of their own" in told
    assert "run `bench view x` when they are done" in told
