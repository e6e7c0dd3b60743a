"""A paper's suite runs the day its data are there: fixtures of the sets under registered names."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from helpers.adapter_checks import fixtures, hard_links
from helpers.posed_scenes import blob
from splatproof.suites.runner import run_suite, select
from splatproof.suites.suite_files import load_suite
from splatproof.suites.workers import in_process


def kitti_0001(folder: Path) -> None:
    """As many frames of sequence 0001 as it has (447): each a link to one of four."""
    fixtures("kitti").tracking(folder, frames=447, paint=False)
    blob(folder / "one.png", np.array([40.0, 30.0]))
    for camera in ("02", "03"):
        names = [folder / f"image_{camera}/0001/{i:06d}.png" for i in range(447)]
        hard_links(folder / "one.png", names)
    fixtures("kitti").scan(folder / "velodyne/0001/000428.bin", 428)


def written(kind: str, folder: Path) -> None:
    """Write the fixture of a set below a data root."""
    writers = {
        "mill19/rubble": fixtures("adapters").mega_nerf,
        "kitti/training": kitti_0001,
        "3das/city_0": partial(fixtures("adapters").nerfstudio, distorted=False, views=9),
    }
    (folder / kind).mkdir(parents=True, exist_ok=True)
    writers[kind](folder / kind)


@pytest.mark.parametrize(
    ("suite", "kind", "only", "held"),
    [
        ("paper_dpgs", "mill19/rubble", "mill19/rubble/3dgs/*/seed0", ["val/rgbs/000000.jpg"]),
        (
            "paper_hdgs",
            "kitti/training",
            "kitti_tracking/0001/*/seed0",
            [f"image_{c}/000{i}.png" for c in ("02", "03") for i in (427, 431)],
        ),
        (
            "paper_hdgs_reconstruction",
            "kitti/training",
            "kitti_tracking/0001/*/seed0",
            [f"image_{c}/000{i}.png" for c in ("02", "03") for i in range(424, 432)],
        ),
        (
            "paper_stratosplat",
            "3das/city_0",
            "3das/city_0/*/seed0",
            ["images/2.png", "images/6.png"],
        ),
    ],
)
def test_a_case_of_a_paper(tmp_path, monkeypatch, suite, kind, only, held):
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    written(kind, tmp_path / "data")
    chosen = select(load_suite(suite), only=only)
    (case,) = chosen.cases
    if case.protocol.clips:  # the last 8 moments of its 52, to be quick
        assert case.protocol.clips[0] == ("0001", 380, 431)
        case = replace(case, protocol=replace(case.protocol, clips=(("0001", 424, 431),)))
    assert case.settings.iterations == 30_000
    points = min(case.settings.random_points, 60)
    short = replace(case, settings=replace(case.settings, iterations=2, random_points=points))
    (outcome,) = run_suite(
        replace(chosen, cases=(short,)), tmp_path / "runs", backend="reference", launch=in_process
    )
    assert not outcome.result.error
    assert [image.name for image in outcome.result.images] == held
    assert outcome.result.metrics["psnr"] > 0
