"""Cases that differ in the rules of scoring alone are trained once; all others are not."""

import json
from dataclasses import replace

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.methods.loading import load_origin
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import held_out
from splatproof.suites import run_case as cases
from splatproof.suites.runner import run_suite, select
from splatproof.suites.same_model import training_key
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

PROTOCOL = load_protocol("default")
HALF = replace(PROTOCOL, name="half", region="right_half", appearance="half", metrics=("psnr",))
CASE = Case(scene="town", method="fake", settings=FakeSettings(), seed=0, protocol=PROTOCOL)


@pytest.fixture
def fits(monkeypatch) -> list[int]:
    """Seeds of the fits that were made."""
    made: list[int] = []

    def fit(scene, settings, run):
        made.append(run.seed)
        return fake_methods.fit(scene, settings, run)

    monkeypatch.setitem(METHODS, "fake", None)  # removed again after the test
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # time is not what is tested here
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()
    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=fit))
    return made


def run(folder, *those: Case, only: str | None = None, resume: bool = True):
    suite = Suite(name="tiny", description="For tests", cases=those, scenes=("town",))
    return run_suite(
        select(suite, only=only), folder, planned=those, backend="reference", launch=in_process,
        resume=resume,
    )  # fmt: skip


def test_one_model_is_scored_under_two_protocols(tmp_path, fits):
    first, second = run(tmp_path, CASE, replace(CASE, protocol=HALF))
    assert fits == [0]
    assert second.status == "finished"
    assert second.result.model_sha256 == first.result.model_sha256
    assert second.result.curve == first.result.curve
    assert second.result.stages["train"] == first.result.stages["train"]
    assert second.result.environment["trained in"] == CASE.label
    assert "trained in" not in first.result.environment
    assert set(second.result.metrics) < set(first.result.metrics)
    for outcome in (first, second):
        told = load_origin(outcome.folder / "model").protocol
        assert told["name"] == outcome.case.protocol.name
    again = run(tmp_path, CASE, replace(CASE, protocol=HALF))
    assert [outcome.status for outcome in again] == ["kept", "kept"]


def test_what_starts_over_takes_no_model_of_before(tmp_path, fits):
    both = (CASE, replace(CASE, protocol=HALF))
    run(tmp_path, *both)
    run(tmp_path, *both, resume=False)
    assert fits == [0, 0]
    run(tmp_path, both[1], resume=False)
    assert fits == [0, 0, 0]


def test_a_model_of_other_files_is_passed_over(tmp_path, fits):
    run(tmp_path, CASE)
    path = tmp_path / "tiny" / CASE.folder / "case.json"
    told = json.loads(path.read_text()) | {"data": {"photos_sha256": "others"}}
    (tmp_path / "tiny" / CASE.folder / "record.json").unlink()
    path.write_text(json.dumps(told) + "\n")
    other = tmp_path / "tiny" / CASE.folder
    job = cases.Job(
        case=replace(CASE, protocol=HALF), suite="tiny", suite_scenes=(), folder=tmp_path / "alone",
        backend="reference", same_model=((other, told["key"]),),
    )  # fmt: skip
    in_process(job, lambda *_: None)
    assert fits == [0, 0]


def test_a_case_that_was_not_chosen_now_lends_its_model_unless_it_is_of_other_settings(
    tmp_path, fits
):
    half = replace(CASE, protocol=HALF)
    run(tmp_path, CASE, half, only="town/fake/default/*")
    (taken,) = run(tmp_path, CASE, half, only="town/fake/half/*")
    assert fits == [0]
    assert taken.result.environment["trained in"] == CASE.label
    more = [replace(one, settings=FakeSettings(iterations=41)) for one in (CASE, half)]
    (own,) = run(tmp_path, *more, only="town/fake/half/*")
    assert fits == [0, 0]
    assert "trained in" not in own.result.environment
    (tmp_path / "tiny" / CASE.folder / "case.json").write_text("{")  # damaged: passed over
    run(tmp_path, CASE, half, only="town/fake/half/*")
    assert fits == [0, 0, 0]


@pytest.mark.parametrize(
    "other",
    [
        replace(CASE, seed=1),
        replace(CASE, pose_noise="L1"),
        replace(CASE, settings=FakeSettings(iterations=41)),
        replace(CASE, protocol=replace(PROTOCOL, hold=3)),
        replace(CASE, protocol=replace(PROTOCOL, background=(1.0, 1.0, 1.0))),
        replace(CASE, protocol=replace(PROTOCOL, masked=False)),
    ],
)
def test_what_training_may_depend_on_has_a_key_of_its_own(other):
    assert training_key(CASE, "cpu") == training_key(replace(CASE, protocol=HALF), "cpu")
    assert training_key(CASE, "cpu") != training_key(CASE, "reference")
    assert training_key(other, "cpu") != training_key(CASE, "cpu")
