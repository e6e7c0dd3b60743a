"""Pose noise as an axis of suites: cases of their own, from the suite file to the leaderboard."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from helpers import case_folders, fake_methods
from helpers.fake_methods import fake_scene
from splatproof.base.errors import UsageError
from splatproof.datasets.pose_noise import LEVELS, disturbed
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.result_json import result_from_json, result_to_json
from splatproof.reference.types.scene import Scene
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.run_data import case_name
from splatproof.suites import held_out
from splatproof.suites import run_case as cases
from splatproof.suites.case_keys import case_key
from splatproof.suites.published.ours import our_rows
from splatproof.suites.records import write_record
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import load_suite
from splatproof.suites.workers import in_process

SUITE = """
description = "For tests"
[[cases]]
scenes = ["town"]
methods = ["fake"]
protocols = ["default"]
seeds = [0, 1]
pose_noise = ["none", "L1", "L3"]
"""
run = partial(run_suite, backend="reference", launch=in_process)


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # time is not what is tested here
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()


@pytest.fixture
def suite(tmp_path: Path):
    path = tmp_path / "noisy.toml"
    path.write_text(SUITE)
    return load_suite(path)


def test_every_level_is_a_case_with_a_key_and_folder_of_its_own(suite):
    assert [case.label for case in suite.cases] == [
        "town/fake/default/seed0", "town/fake/default/seed1",
        "town/fake~pose-noise-L1/default/seed0", "town/fake~pose-noise-L1/default/seed1",
        "town/fake~pose-noise-L3/default/seed0", "town/fake~pose-noise-L3/default/seed1",
    ]  # fmt: skip
    assert len({case_key(case, "cpu") for case in suite.cases}) == 6


def test_a_suite_that_says_nothing_has_true_poses(tmp_path):
    path = tmp_path / "plain.toml"
    path.write_text("\n".join(line for line in SUITE.splitlines() if "pose_noise" not in line))
    assert [case.pose_noise for case in load_suite(path).cases] == ["none", "none"]


@pytest.mark.parametrize(
    ("value", "said"),
    [('["L4"]', r"cases\[0\].pose_noise: unknown 'L4'"), ("[]", r"cases\[0\].pose_noise: empty"),
     ("[0.5]", "pose_noise"), ('["L1", "L1"]', "is there twice")],
)  # fmt: skip
def test_levels_that_there_are_not(tmp_path, value, said):
    path = tmp_path / "bad.toml"
    path.write_text(SUITE.replace('["none", "L1", "L3"]', value))
    with pytest.raises(UsageError, match=said):
        load_suite(path)


def test_training_gets_the_noise_and_scoring_the_truth(suite, tmp_path, monkeypatch):
    """The noise is the case's seed's; what is scored is looked at from where it truly was."""
    trained: dict[int, Scene] = {}
    scored: list[Scene] = []
    method = METHODS["fake"]

    def fit(scene, settings, given):
        trained[given.seed] = scene
        return method.fit(scene, settings, given)

    def geometry(scene, model):
        scored.append(scene)
        return {}

    monkeypatch.setitem(METHODS, "fake", replace(method, fit=fit))
    monkeypatch.setattr(cases, "geometry_metrics", geometry)
    outcomes = run(replace(suite, cases=suite.cases[2:4]), tmp_path)
    true = fake_scene("town", load_protocol("default"))
    assert [one.status for one in outcomes] == ["finished", "finished"]
    for outcome in outcomes:
        seed = outcome.case.seed
        want = disturbed(true, "L1", seed)
        for view, other in zip(want.views, trained[seed].views, strict=True):
            assert torch.equal(view.camera.world_to_camera, other.camera.world_to_camera)
        assert outcome.result.pose_noise == "L1"
        assert outcome.result.scene_facts["pose_noise_seed"] == str(seed)
    for scene in scored:
        for view, other in zip(true.views, scene.views, strict=True):
            assert torch.equal(view.camera.world_to_camera, other.camera.world_to_camera)


def test_a_finished_noisy_case_is_kept_and_another_level_is_not(suite, tmp_path):
    run(replace(suite, cases=suite.cases[2:3]), tmp_path)
    first, second = run(replace(suite, cases=(suite.cases[2], suite.cases[4])), tmp_path)
    assert (first.status, second.status) == ("kept", "finished")
    # a record that was moved into another level's folder does not count there
    record = json.loads((first.folder / "record.json").read_text())
    (second.folder / "record.json").write_text(json.dumps(record))
    (again,) = run(replace(suite, cases=suite.cases[4:5]), tmp_path)
    assert again.status == "finished"


def test_levels_are_rows_of_their_own_wherever_results_are_shown(tmp_path):
    results = [
        replace(case_folders.result(seed=seed), pose_noise=level)
        for seed in range(3)
        for level in ("none", "L2")
    ]
    (table,) = build_tables(results)
    assert {row.label: row.seeds for row in table.rows} == {"3dgs": 3, "3dgs~pose-noise-L2": 3}
    assert len({case_name(result) for result in results}) == 6
    for index, result in enumerate(results):
        folder = tmp_path / "quick" / str(index)
        folder.mkdir(parents=True)
        write_record(folder, result)
    assert {row.method: row.seeds for row in our_rows(tmp_path / "quick")} == {
        "3dgs": 3, "3dgs~pose-noise-L2": 3,
    }  # fmt: skip


def test_a_record_from_before_there_was_noise_has_none():
    record = json.loads(result_to_json(case_folders.result()))
    del record["pose_noise"]
    assert result_from_json(json.dumps(record), "old").pose_noise == "none"


def test_no_noise_is_the_scene_itself():
    scene = fake_scene("town", load_protocol("default"))
    assert disturbed(scene, "none", 3) is scene
    assert list(LEVELS) == ["none", "L1", "L2", "L3"]
