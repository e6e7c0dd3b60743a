"""A case whose scene has changed under the same name runs again, and what it had is kept apart."""

import json
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.base.errors import DataError
from splatproof.methods.dpgs.refiners import REFINER
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import Result
from splatproof.reference.types.scene import Scene
from splatproof.reports.store import find_cases
from splatproof.suites import held_out, runner, scene_data
from splatproof.suites import run_case as cases
from splatproof.suites.records import read_finished, read_record, write_record
from splatproof.suites.runner import Progress, run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

FOLDER = Path("tiny/town/fake/default/seed0")


@pytest.fixture
def town(tmp_path, monkeypatch) -> Path:
    """A scene folder of two photos and a model that can be changed behind a suite's back."""
    folder = tmp_path / "town"
    folder.mkdir()
    for name in ("a.png", "b.png", "model"):
        (folder / name).write_text(name)

    def opened(spec: str | Path, protocol: Protocol) -> Scene:
        if (folder / "broken").exists():
            raise DataError(f"{folder}: no scene found here")
        return replace(
            fake_scene("town", protocol),
            root=folder,
            sources=(folder / "a.png", folder / "b.png"),
            facts={"model_sha256": (folder / "model").read_text(), "torch": "2"},
        )

    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # time is not what is tested here
    for module in (cases, scene_data):
        monkeypatch.setattr(module, "open_scene", opened)
    fake_methods.register()
    for module in (cases, scene_data):
        monkeypatch.setattr(module, "open_scene", opened)
    return folder


def run(out: Path, seen: list[Progress] | None = None, **settings: Any) -> tuple[str, Result]:
    """Status and result of the one case of the suite."""
    fake = FakeSettings(**settings)
    protocol = load_protocol("default")
    case = Case(scene="town", method="fake", settings=fake, seed=0, protocol=protocol)
    suite = Suite(name="tiny", description="For tests", cases=(case,), scenes=("town",))
    listen = (lambda _: None) if seen is None else seen.append
    start = partial(run_suite, backend="reference", launch=in_process, on_progress=listen)
    (outcome,) = start(suite, out)
    return outcome.status, outcome.result


def started(seen: list[Progress]) -> str:
    (note,) = [progress.note for progress in seen if progress.stage == "start"]
    return note


@pytest.mark.parametrize(
    ("name", "said"), [("b.png", "its photos, masks or depth"), ("model", "its COLMAP model")]
)
def test_other_data_under_the_name_run_again_and_the_old_result_is_kept(town, tmp_path, name, said):
    out = tmp_path / "runs"
    first = run(out)[1]
    assert first.scene_facts["files_sha256"]
    (town / name).write_text("bump!" if name == "b.png" else "other")
    seen: list[Progress] = []
    status, again = run(out, seen)
    assert status == "finished"
    assert again.scene_facts != first.scene_facts
    kept = out / "tiny/.replaced/town/fake/default/seed0/1"
    assert f"runs again: {said} changed since; the old result is in {kept}" in started(seen)
    assert read_record(kept) == first
    assert {path.name for path in (kept / "renders").iterdir()} == {"0.png", "3.png"}
    assert find_cases(out) == [out / FOLDER]
    assert read_finished(out) == [again]
    assert run(out)[0] == "kept"
    (town / name).write_text("third")
    assert run(out)[0] == "finished"
    assert read_record(kept.with_name("2")) == again


def test_other_weights_of_a_refiner_run_again(town, tmp_path, monkeypatch):
    weights = iter(["one", "one", "two"])
    monkeypatch.setattr(runner, "refiner_facts", lambda settings: {REFINER: next(weights)})
    out, seen = tmp_path / "runs", list[Progress]()
    assert run(out)[1].scene_facts[REFINER] == "one"
    assert run(out)[0] == "kept"
    assert run(out, seen)[0] == "finished"
    assert "runs again: its refiner's weights changed since" in started(seen)


def test_the_same_data_with_other_times_or_in_another_place_are_the_same(town, tmp_path):
    out = tmp_path / "runs"
    run(out)
    os.utime(town / "a.png", ns=(1, 1))
    assert run(out)[0] == "kept"
    (out / "tiny/.files.json").unlink()
    assert run(out)[0] == "kept"


@pytest.mark.parametrize("damage", ["{", "[]", '{"a": 1}', '{"a": [1, 2]}'])
def test_a_damaged_list_of_known_files_is_made_again(town, tmp_path, damage):
    out = tmp_path / "runs"
    run(out)
    whole = (out / "tiny/.files.json").read_text()
    assert len(json.loads(whole)) == 2
    (out / "tiny/.files.json").write_text(damage)
    assert run(out)[0] == "kept"
    assert (out / "tiny/.files.json").read_text() == whole


def test_a_result_is_kept_where_its_scene_cannot_be_read_now(town, tmp_path):
    out = tmp_path / "runs"
    run(out)
    (town / "broken").touch()
    seen: list[Progress] = []
    assert run(out, seen)[0] == "kept"
    assert f"kept, unchecked: {town}: no scene found here" in started(seen)


def test_what_was_cut_off_waits_for_a_scene_that_cannot_be_read_now(town, tmp_path):
    out = tmp_path / "runs"
    assert run(out, fail_with="stop")[0] == "failed"
    state = out / FOLDER / "checkpoint/state.json"
    before = state.read_text(), (out / FOLDER / "case.json").read_text()
    (town / "broken").touch()
    status, result = run(out, fail_with="stop")
    assert (status, result.error) == ("failed", f"{town}: no scene found here")
    assert (state.read_text(), (out / FOLDER / "case.json").read_text()) == before
    (town / "broken").unlink()
    status, result = run(out, fail_with="stop")
    assert (status, result.error) == ("failed", "stop")
    points = json.loads((out / FOLDER / "curve.jsonl").read_text().splitlines()[-1])
    assert points["step"] == 19
    assert state.read_text() == before[0]


def test_an_old_result_that_was_removed_leaves_its_number_free(town, tmp_path):
    out = tmp_path / "runs"
    for content in ("one", "two", "three"):
        (town / "model").write_text(content)
        run(out)
    places = out / "tiny/.replaced/town/fake/default/seed0"
    assert {path.name for path in places.iterdir()} == {"1", "2"}
    shutil.rmtree(places / "1")
    (town / "model").write_text("four")
    assert run(out)[0] == "finished"
    assert {path.name for path in places.iterdir()} == {"2", "3"}


def test_a_record_from_before_its_files_were_hashed_is_compared_by_what_it_has(town, tmp_path):
    out = tmp_path / "runs"
    result = run(out)[1]
    older = {k: v for k, v in result.scene_facts.items() if k != "files_sha256"}
    write_record(out / FOLDER, replace(result, scene_facts=older | {"torch": "1"}))
    assert run(out)[0] == "kept"
    (town / "model").write_text("other")
    assert run(out)[0] == "finished"


def test_training_that_was_cut_off_is_not_continued_on_other_data(town, tmp_path, monkeypatch):
    out = tmp_path / "runs"
    assert run(out, fail_with="stop")[0] == "failed"
    (out / FOLDER / "record.json").unlink()
    case = out / FOLDER / "case.json"
    before = case.read_text()
    (town / "a.png").write_text("other")
    assert run(out, fail_with="stop")[0] == "failed"
    assert case.read_text() != before

    undisturbed = run(tmp_path / "other")[1]
    assert run(out)[1].model_sha256 == undisturbed.model_sha256
