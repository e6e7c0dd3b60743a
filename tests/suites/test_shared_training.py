"""Cases that differ in how they are scored alone are trained once, and score as if trained apart."""

from dataclasses import replace
from functools import partial

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import run_case as cases
from splatproof.suites.runner import Progress, run_suite
from splatproof.suites.scene_data import SceneData
from splatproof.suites.shared_training import training_key
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

PROTOCOL = load_protocol("default")
SCORED_OTHERWISE = replace(PROTOCOL, name="other", appearance="oracle", rounding="float")


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    monkeypatch.setattr(SceneData, "of", lambda *_: {"files_sha256": "0"})
    fake_methods.register()


def case(**changes) -> Case:
    plain = Case(
        scene="town", method="fake", settings=FakeSettings(), seed=0, protocol=PROTOCOL
    )  # fmt: skip
    return replace(plain, **changes)


def trained(folder, *those: Case, **options) -> tuple[list[str], list]:
    """Labels of the cases that were trained, and all outcomes."""
    found = []

    def hear(progress: Progress) -> None:
        if progress.stage == "train" and progress.step == 1:
            found.append(progress.case.label)

    suite = Suite(name="tiny", description="For tests", cases=those, scenes=("town",))
    run = partial(run_suite, backend="reference", launch=in_process)
    return found, list(run(suite, folder, on_progress=hear, **options))


def test_a_case_that_is_scored_otherwise_takes_the_model_over(tmp_path):
    one, other = case(), case(protocol=SCORED_OTHERWISE)
    labels, (first, second) = trained(tmp_path / "both", one, other)
    assert labels == [one.label]
    _, (alone,) = trained(tmp_path / "alone", other)
    assert second.status == "finished"
    assert second.result.protocol == "other"
    assert second.result.images == alone.result.images
    assert second.result.images != first.result.images
    assert second.result.curve == alone.result.curve == first.result.curve
    assert second.result.model_sha256 == first.result.model_sha256
    assert second.result.training_seconds == first.result.training_seconds
    assert trained(tmp_path / "both", one, other)[1][1].status == "kept"


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 1},
        {"settings": FakeSettings(iterations=39)},
        {"protocol": replace(SCORED_OTHERWISE, width=3)},
        {"protocol": replace(SCORED_OTHERWISE, hold=2)},
        {"pose_noise": "L1"},
    ],
)
def test_everything_else_is_trained_anew(tmp_path, changes):
    other = case(**{"protocol": SCORED_OTHERWISE, **changes})
    assert trained(tmp_path, case(), other)[0] == [case().label, other.label]
    assert training_key(case(), "cpu") != training_key(other, "cpu")


def test_other_data_or_a_fresh_start_are_trained_anew(tmp_path, monkeypatch):
    one, other = case(), case(protocol=SCORED_OTHERWISE)
    trained(tmp_path, one)
    monkeypatch.setattr(SceneData, "of", lambda *_: {"files_sha256": "1"})
    assert trained(tmp_path, other)[0] == [other.label]
    assert trained(tmp_path, one, other, resume=False)[0] == [one.label, other.label]


def test_a_name_is_no_part_of_a_training():
    assert training_key(case(variant="x"), "cpu") == training_key(case(), "cpu")
    assert training_key(case(), "cuda") != training_key(case(), "cpu")


def test_what_a_killed_case_left_is_not_taken_over(tmp_path):
    one, other = case(), case(protocol=SCORED_OTHERWISE)
    _, (first,) = trained(tmp_path, one)
    (first.folder / "trained.json").unlink()
    assert trained(tmp_path, other)[0] == [other.label]
