"""Depth priors as an axis of suites: cases of their own, from the suite file to the leaderboard."""

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import pytest
import torch

from helpers import case_folders, fake_methods
from helpers.fake_methods import fake_scene
from helpers.prior_scenes import plane_scene
from splatproof.base.errors import UsageError
from splatproof.datasets.pose_noise import disturbed
from splatproof.methods.loading import load_origin
from splatproof.methods.priors.kinds import KINDS
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.protocol import key_rules
from splatproof.reference.types.result_json import result_from_json, result_to_json
from splatproof.reference.types.scene import DepthPrior, Scene
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.run_data import case_name
from splatproof.suites import held_out
from splatproof.suites import run_case as cases
from splatproof.suites.case_keys import case_key, key_of
from splatproof.suites.runner import Progress, run_suite
from splatproof.suites.suite_files import load_suite
from splatproof.suites.training_scene import training_scene
from splatproof.suites.workers import in_process

SUITE = """
description = "For tests"
[[cases]]
scenes = ["town"]
methods = ["fake"]
protocols = ["default"]
seeds = [0, 1]
depth_prior = ["none", "oracle", "lidar"]
"""
run = partial(run_suite, backend="reference", launch=in_process)


def opened(spec, protocol) -> Scene:
    return replace(fake_scene(spec, protocol), views=plane_scene().views)


@pytest.fixture(autouse=True)
def _fakes(monkeypatch, tmp_path):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # time is not what is tested here
    monkeypatch.setattr(cases, "open_scene", opened)
    fake_methods.register()
    monkeypatch.setattr(cases, "open_scene", opened)


@pytest.fixture
def suite(tmp_path: Path):
    path = tmp_path / "priors.toml"
    path.write_text(SUITE)
    return load_suite(path)


def test_every_prior_is_a_case_with_a_key_and_folder_of_its_own(suite):
    assert [case.label for case in suite.cases] == [
        "town/fake/default/seed0", "town/fake/default/seed1",
        "town/fake~depth-oracle/default/seed0", "town/fake~depth-oracle/default/seed1",
        "town/fake~depth-lidar/default/seed0", "town/fake~depth-lidar/default/seed1",
    ]  # fmt: skip
    assert len({case_key(case, "cpu") for case in suite.cases}) == 6


def test_without_one_a_case_has_the_key_that_it_always_had(suite):
    """Records from before there were priors still count."""
    case = suite.cases[0]
    assert case_key(case, "cpu") == key_of(
        scene="town", method="fake", settings=asdict(case.settings), seed=0,
        protocol=key_rules(asdict(case.protocol)), pose_noise="none", backend="cpu",
    )  # fmt: skip


def test_noise_and_prior_both_stand_in_the_row(suite):
    case = replace(suite.cases[2], pose_noise="L1", variant="x")
    assert case.row == "fake@x~pose-noise-L1~depth-oracle"


@pytest.mark.parametrize(
    ("value", "said"),
    [('["orakle"]', r"cases\[0\].depth_prior: unknown 'orakle', did you mean 'oracle'"),
     ("[]", r"cases\[0\].depth_prior: empty"), ("[0.5]", "depth_prior"),
     ('["oracle", "oracle"]', "is there twice")],
)  # fmt: skip
def test_priors_that_there_are_not(tmp_path, value, said):
    path = tmp_path / "bad.toml"
    path.write_text(SUITE.replace('["none", "oracle", "lidar"]', value))
    with pytest.raises(UsageError, match=said):
        load_suite(path)


def test_training_gets_the_prior_and_neither_truth_nor_that_of_held_out_views(
    suite, tmp_path, monkeypatch
):
    given: list[Scene] = []
    method, told = METHODS["fake"], []

    def fit(scene, settings, run):
        given.append(scene)
        return method.fit(scene, settings, run)

    monkeypatch.setitem(METHODS, "fake", replace(method, fit=fit))
    listen = told.append
    outcomes = run(replace(suite, cases=suite.cases[::2]), tmp_path, on_progress=listen)
    assert [one.status for one in outcomes] == ["finished"] * 3
    for scene, outcome in zip(given, outcomes, strict=True):
        prior = outcome.case.depth_prior
        assert outcome.result.depth_prior == prior
        assert outcome.result.scene_facts.get("depth_prior", "none") == prior
        assert load_origin(outcome.folder / "model").depth_prior == prior
        for index, view in enumerate(scene.views):
            wanted = prior != "none" and index in (1, 2, 4, 5)
            assert (view.load_prior is not None) == wanted
            assert view.load_depth is None
    stages = [
        (at.step, at.total) for at in told if isinstance(at, Progress) and at.stage == "priors"
    ]
    assert stages.count((4, 4)) == 2


def test_views_of_which_a_prior_says_nothing_are_told_and_recorded(suite, tmp_path, monkeypatch):
    def prepare(scene: Scene, weights: Path | None, seed: int):
        return lambda index: DepthPrior(
            disparity=torch.ones(scene.views[index].size),
            valid=torch.full(scene.views[index].size, index > 2),
        )

    monkeypatch.setitem(KINDS, "oracle", replace(KINDS["oracle"], prepare=prepare))
    told = []
    (outcome,) = run(replace(suite, cases=suite.cases[2:3]), tmp_path, on_progress=told.append)
    silent = outcome.result.scene_facts["depth_prior_silent"]
    assert len(silent.split(", ")) == 2
    notes = [
        at.note for at in told if isinstance(at, Progress) and at.stage == "priors" and at.note
    ]
    assert notes == [f"depth prior 'oracle' says nothing of {silent}"]


def test_a_prior_is_seen_from_the_noisy_camera_as_the_method_sees_the_view(suite):
    case = replace(suite.cases[4], pose_noise="L3")
    true = opened("town", load_protocol("default"))
    noisy = training_scene(true, case, {})
    want = disturbed(true, "L3", 0)
    assert torch.equal(noisy.views[1].camera.world_to_camera, want.views[1].camera.world_to_camera)
    still = training_scene(true, suite.cases[4], {})
    moved, straight = noisy.views[1].load_prior, still.views[1].load_prior
    assert moved is not None
    assert straight is not None
    assert not torch.equal(moved().disparity, straight().disparity)


def test_a_finished_case_is_kept_and_another_prior_is_not(suite, tmp_path):
    run(replace(suite, cases=suite.cases[2:3]), tmp_path)
    first, second = run(replace(suite, cases=(suite.cases[2], suite.cases[4])), tmp_path)
    assert (first.status, second.status) == ("kept", "finished")
    (second.folder / "record.json").write_text((first.folder / "record.json").read_text())
    (again,) = run(replace(suite, cases=suite.cases[4:5]), tmp_path)
    assert again.status == "finished"


def test_what_a_scene_lacks_fails_the_case_in_one_line(suite, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    (outcome,) = run(replace(suite, cases=suite.cases[4:5]), tmp_path)
    assert outcome.status == "failed"
    assert outcome.result.error.startswith("town: no training view has a LiDAR sweep")


def test_priors_are_rows_of_their_own_wherever_results_are_shown():
    results = [
        replace(case_folders.result(seed=seed), depth_prior=prior)
        for seed in range(3)
        for prior in ("none", "network-a")
    ]
    (table,) = build_tables(results)
    assert {row.label: row.seeds for row in table.rows} == {"3dgs": 3, "3dgs~depth-network-a": 3}
    assert len({case_name(result) for result in results}) == 6


def test_a_record_from_before_there_were_priors_has_none():
    record = json.loads(result_to_json(case_folders.result()))
    del record["depth_prior"]
    assert result_from_json(json.dumps(record), "old").depth_prior == "none"


def test_a_model_from_before_there_were_priors_opens(suite, tmp_path):
    (outcome,) = run(replace(suite, cases=suite.cases[:1]), tmp_path)
    path = outcome.folder / "model" / "model.json"
    told = json.loads(path.read_text())
    assert told["origin"].pop("depth_prior") == "none"
    path.write_text(json.dumps(told))
    assert load_origin(outcome.folder / "model").depth_prior == "none"
