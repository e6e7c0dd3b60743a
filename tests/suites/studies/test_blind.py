"""The blind test of seams: it finds a step of colour that it was shown, and guesses where there is none."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.city_scene import small_scene
from splatproof.cli import main
from splatproof.datasets.photos import write_png
from splatproof.methods.city.model import REGIONS
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.regions import save_regions
from splatproof.reference.types.result import picture_name
from splatproof.suites.studies import blind
from splatproof.suites.studies.blind import SIDE, Kept, accuracy, draw, places, rows
from splatproof.suites.studies.seam_classifier import chance, trained


def textures(count: int, step: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Noise, half of it with one half brighter by a step, at any angle of a right turn."""
    generator = torch.Generator().manual_seed(seed)
    crops = torch.rand(count, 3, SIDE, SIDE, generator=generator) * 0.3 + 0.3
    seams = torch.arange(count) % 2 == 0
    factor = torch.ones(count, 1, 1, SIDE)
    factor[seams, :, :, SIDE // 2 :] = 1 + step
    crops = crops * factor
    crops[::3] = crops[::3].transpose(2, 3)
    return crops, seams


def test_a_step_that_was_shown_is_found_and_none_is_guessed():
    network = trained(*textures(400, 0.3, 0), steps=150, seed=0)
    for step, low, high in ((0.3, 0.9, 1.0), (0.0, 0.4, 0.6)):
        crops, seams = textures(300, step, 1)
        said = chance(network, crops)
        assert bool(((said >= 0) & (said <= 1)).all())
        assert low <= float(((said > 0.5) == seams).float().mean()) <= high


def test_a_seed_gives_the_same_classifier_and_leaves_torchs_generator_alone():
    crops, seams = textures(60, 0.3, 0)
    before = torch.random.get_rng_state()
    ends = [chance(trained(crops, seams, steps=5, seed=s), crops) for s in (3, 3, 4)]
    assert torch.equal(ends[0], ends[1])
    assert not torch.equal(ends[0], ends[2])
    assert torch.equal(before, torch.random.get_rng_state())


@given(st.integers(0, 150), st.integers(0, 60), st.integers(0, 5))
def test_crops_are_as_many_of_a_seam_as_of_none_and_lie_where_they_say(left, width, seed):
    mask = np.zeros((100, 160), dtype=bool)
    mask[:, left : left + width] = True
    found = places(mask, "a.jpg", np.random.default_rng(seed))
    assert sum(one.seam for one in found) * 2 == len(found)
    for one in found:
        part = mask[one.top : one.top + SIDE, one.left : one.left + SIDE]
        assert part.shape == (SIDE, SIDE)
        assert part.mean() >= blind.MOST_SEAM if one.seam else not part.any()
    assert len({(one.top, one.left) for one in found}) == len(found)
    assert found == places(mask, "a.jpg", np.random.default_rng(seed))
    if width == 0:
        assert found == []


def test_accuracy_counts_crops_and_its_interval_is_over_views():
    truth = {view: np.array([True, False, True, False]) for view in "abcd"}
    right = {view: np.array([0.9, 0.1, 0.8, 0.2]) for view in "abcd"}
    assert accuracy(right, truth) == (1.0, 1.0, 1.0)
    mixed = right | {"a": np.array([0.1, 0.9, 0.2, 0.8])}
    told, low, high = accuracy(mixed, truth)
    assert (told, high) == (0.75, 1.0)
    assert low < 0.6
    half = {view: np.array([0.9, 0.9, 0.1, 0.1]) for view in "abcd"}
    assert accuracy(half, truth) == (0.5, 0.5, 0.5)


def made(folder: Path, monkeypatch) -> None:
    """Runs of two rows on the small scene: the hard cut is brighter in one block, the other row is not."""
    scene = small_scene(60)
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    scene = replace(scene, train=(), test=tuple(range(len(scene.views))))
    generator = np.random.default_rng(0)
    cases, masks = [], {}
    for view in scene.views:
        size = (max(96, view.camera.height), max(128, view.camera.width))
        masks[view.name] = np.zeros(size, dtype=bool)
        masks[view.name][:, 48:80] = True
    for row, step in (("stitchgs@hard", 60), ("stitchgs@fade", 0)):
        at = folder / "city" / row / "seed0"
        (at / "model").mkdir(parents=True)
        save_regions(at / "model" / REGIONS, found.regions)
        for view in scene.views:
            plain = generator.integers(60, 120, (*masks[view.name].shape, 3)).astype(np.uint8)
            stepped = plain.copy()
            stepped[:, 64:][masks[view.name][:, 64:]] += np.uint8(step)
            (at / "renders").mkdir(exist_ok=True)
            (at / "truth").mkdir(exist_ok=True)
            write_png(at / "renders" / picture_name(view.name), stepped)
            write_png(at / "truth" / picture_name(view.name), plain)
        cases.append((("small", row, 0), Kept(protocol="city_400", folder=at)))
    monkeypatch.setattr(blind, "_cases", lambda _: iter(cases))
    monkeypatch.setattr(blind, "open_scene", lambda *_: scene)
    monkeypatch.setattr(
        blind,
        "partition_seam_mask",
        lambda camera, *_: torch.from_numpy(masks[by_camera[id(camera)]]),
    )
    monkeypatch.setattr(blind, "surface_depth", lambda *_: torch.zeros(1, 1))
    by_camera = {id(view.camera): view.name for view in scene.views}


def test_rows_tell_the_hard_cut_and_not_the_merge_without_a_step(tmp_path, monkeypatch):
    made(tmp_path, monkeypatch)
    monkeypatch.setattr(blind, "TRAINING", 120)
    found = list(rows(quick=False, runs=tmp_path))
    assert [row["merge"] for row in found] == ["stitchgs@hard", "stitchgs@fade", "photos"]
    told = [row["told"] for row in found]
    assert told[0] > 0.8
    assert all(abs(one - 0.5) < 0.15 for one in told[1:])
    assert all(row["low"] <= row["told"] <= row["high"] for row in found)
    json.dumps(found)
    (picture,) = draw(found, tmp_path)
    assert picture.is_file()


def test_without_runs_or_a_merge_in_them_it_says_what_to_do(tmp_path, capsys):
    assert main(["study", "blind", "--out", str(tmp_path), "--quiet"]) == 2
    assert "--runs RUNS" in capsys.readouterr().err
    assert main(["study", "blind", "--runs", str(tmp_path), "--out", str(tmp_path), "--quiet"]) == 2
    assert "run suite city first" in capsys.readouterr().err
