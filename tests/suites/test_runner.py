"""Cases are run once, resumed, re-run when their settings change, and fail alone."""

import errno
import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from helpers import fake_methods
from helpers.colmap_scenes import Flight, view_name, write_scene
from helpers.fake_methods import FakeSettings, fake_scene, run_fake_case
from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import UsageError
from splatproof.base.files import write_text
from splatproof.base.locks import locked
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import truth_sha256
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import Result
from splatproof.suites import case_folder, held_out, workers
from splatproof.suites import run_case as cases
from splatproof.suites.held_out import kept
from splatproof.suites.records import read_record
from splatproof.suites.runner import run_suite, select
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process, in_worker

PROTOCOL = load_protocol("default")
FIRST = Path("tiny/town/fake/default/seed0")


def fakes(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(METHODS, "fake", None)  # removed again after the test
    patch.setattr(held_out, "TIMED_FRAMES", 3)  # time is not what is tested here
    patch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    fakes(monkeypatch)


def case(scene: str = "town", seed: int = 0, **settings: Any) -> Case:
    fake = FakeSettings(**settings)
    return Case(scene=scene, method="fake", settings=fake, seed=seed, protocol=PROTOCOL)


def suite(*those: Case) -> Suite:
    return Suite(name="tiny", description="For tests", cases=those, scenes=("town",))


run = partial(run_suite, backend="reference", launch=in_process)


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """What a run of the one case leaves: each test gets a copy."""
    folder = tmp_path_factory.mktemp("done")
    with pytest.MonkeyPatch.context() as patch:
        fakes(patch)
        run(suite(case()), folder)
    return folder


@pytest.fixture
def first(done, tmp_path) -> Result:
    """The result of the one case, which has run in `tmp_path`."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    return read_record(tmp_path / FIRST)


def test_what_was_spent_elsewhere_is_part_of_the_costs(tmp_path):
    (outcome,) = run(suite(case(elsewhere=50_000.0)), tmp_path)
    result = read_record(outcome.folder)
    assert 50_000 < result.cpu_seconds < 60_000
    assert result.peak_memory_mb == 50_000


def test_a_case_with_marks_says_how_long_photos_were_read_beside_its_training(
    tmp_path, monkeypatch
):
    read = {"decode": 3.0, "undistort": 0.5, "resize": 0.25}
    clock = SimpleNamespace(seconds=lambda: 7.0, since=lambda earlier: read if earlier == 7 else {})
    monkeypatch.setattr(cases, "READING", clock)
    timed, other = run(suite(replace(case(), marks=(1e6,)), case(seed=1)), tmp_path)
    values = read_record(timed.folder).metrics
    assert {name: values[f"{name}_seconds"] for name in read} == read
    assert not {f"{name}_seconds" for name in read} & read_record(other.folder).metrics.keys()


def test_a_case_leaves_a_whole_record_and_pictures(tmp_path):
    (outcome,) = run(suite(case()), tmp_path)
    assert outcome.status == "finished"
    assert outcome.folder == tmp_path / "tiny" / "town" / "fake" / "default" / "seed0"
    result = read_record(outcome.folder)
    assert result == outcome.result
    assert not result.error
    assert (result.suite, result.suite_scenes) == ("tiny", ("town",))
    assert [image.name for image in result.images] == ["0.png", "3.png"]
    assert set(PROTOCOL.metrics) <= set(result.metrics)
    assert set(result.stages) == {"load", "init", "train", "save", "score"}
    assert result.settings["inner"] == {"rate": 0.5, "cap": None}
    assert result.curve[-1][0] == 40
    assert len(result.curve) == 40
    assert result.primitives == 12
    assert result.bytes_on_disk == sum(
        f.stat().st_size for f in (outcome.folder / "model").iterdir()
    )
    assert 50 < result.peak_memory_mb < 100_000
    assert result.cpu_seconds > 0
    assert result.render_ms > 0
    assert result.environment["backend"] == "reference"
    assert result.counters == {}  # neither this method nor this backend counts
    assert result.left_out == (("blurred.jpg", "did not register"),)
    for kind in ("renders", "truth", "errors"):
        assert sorted(p.name for p in (outcome.folder / kind).iterdir()) == ["0.png", "3.png"]
    assert not (outcome.folder / "checkpoint").exists()
    assert not list(tmp_path.rglob("*.partial"))


def test_the_saved_pictures_are_what_was_scored(first, tmp_path):
    view = fake_scene("town", PROTOCOL).test_views[0]
    image = first.images[0]
    truth, _ = kept(view.load(), "float")
    assert image.truth_sha256 == truth_sha256(truth)
    read = cv2.imread(str(tmp_path / FIRST / "renders" / "0.png"))
    assert read is not None
    render = read[..., ::-1] / 255
    mse = np.mean((render - view.load().double().numpy()) ** 2)
    assert image.metrics["psnr"] == pytest.approx(-10 * math.log10(mse), abs=1e-4)


def test_a_finished_case_is_kept_and_another_seed_runs(first, tmp_path):
    before = (tmp_path / FIRST / "record.json").stat().st_mtime_ns
    outcomes = run(suite(case(), case(seed=1)), tmp_path)
    assert [outcome.status for outcome in outcomes] == ["kept", "finished"]
    assert (tmp_path / FIRST / "record.json").stat().st_mtime_ns == before
    kept, second = (outcome.result for outcome in outcomes)
    assert kept == first
    assert first.model_sha256 != second.model_sha256


def test_the_same_seed_gives_the_same_numbers(first, tmp_path):
    (second,) = run(suite(case()), tmp_path / "b")
    assert first.metrics == second.result.metrics
    assert first.images == second.result.images
    assert first.model_sha256 == second.result.model_sha256
    assert first.curve == second.result.curve


@pytest.mark.parametrize(
    "changed",
    [
        case(iterations=41),
        replace(case(), protocol=replace(PROTOCOL, rounding="truncate")),
    ],
    ids=["settings", "rules of the same name"],
)
def test_what_a_number_depends_on_makes_the_case_run_again_and_says_so(first, tmp_path, changed):
    notes = []
    (outcome,) = run(suite(changed), tmp_path, on_progress=lambda p: notes.append(p.note))
    assert outcome.status == "finished"
    assert any(
        "other settings, protocol, pose noise, depth prior or backend" in note for note in notes
    )
    (kept,) = run(suite(changed), tmp_path)
    assert kept.status == "kept"


def test_a_checkpoint_of_other_settings_is_not_continued(done, tmp_path):
    failing = case(fail_with="no", iterations=40)
    run(suite(failing), tmp_path)
    folder = tmp_path / "tiny/town/fake/default/seed0"
    assert (folder / "checkpoint").exists()
    (outcome,) = run(suite(case()), tmp_path)
    assert outcome.result.model_sha256 == read_record(done / FIRST).model_sha256
    assert not (folder / "failure.txt").exists()


def test_starting_over_runs_a_finished_case_again(first, tmp_path):
    (again,) = run(suite(case()), tmp_path, resume=False)
    assert again.status == "finished"
    assert again.result.images == first.images


@pytest.mark.parametrize("damage", ["cut", "empty", "version", "not JSON"])
def test_a_damaged_record_is_made_again(first, tmp_path, damage):
    path = tmp_path / FIRST / "record.json"
    text = path.read_text()
    path.write_text(
        {
            "cut": text[:100],
            "empty": "",
            "version": text.replace('"version": 1', '"version": 99'),
            "not JSON": "hello",
        }[damage]
    )
    notes = []
    (again,) = run(suite(case()), tmp_path, on_progress=lambda p: notes.append(p.note))
    assert again.status == "finished"
    assert again.result.images == first.images
    assert notes[0].startswith("runs again: ")
    assert str(path) in notes[0]


def test_a_failing_case_is_recorded_and_the_others_go_on(tmp_path):
    bad = case(fail_with="the sky fell", seed=1)
    outcomes = run(suite(case("broken"), bad, case(seed=2)), tmp_path)
    assert [outcome.status for outcome in outcomes] == ["failed", "failed", "finished"]
    assert outcomes[0].result.error == "broken: no scene found here"
    assert outcomes[1].result.error == "the sky fell"
    assert "DataError" in (outcomes[1].folder / "failure.txt").read_text()
    assert read_record(outcomes[1].folder).images == ()
    again = run(suite(bad), tmp_path)
    assert again[0].status == "failed"


@pytest.mark.parametrize(
    "fault", ["no test view", "has no masked form", "leaves no pixel to score"]
)
def test_what_cannot_be_scored_is_not_trained(tmp_path, monkeypatch, fault):
    def opened(spec, protocol):
        scene = fake_scene(spec, protocol)
        if fault == "no test view":
            return replace(scene, test=())
        mask = torch.full((18, 24), fault == "has no masked form")
        views = tuple(replace(view, load_mask=mask.clone) for view in scene.views)
        return replace(scene, views=views)

    monkeypatch.setattr(cases, "open_scene", opened)
    monkeypatch.setattr(cases, "load_weights", lambda names: {})
    learned = replace(PROTOCOL, metrics=("psnr", "lpips_alex_m11"))
    learned = PROTOCOL if fault == "leaves no pixel to score" else learned
    (outcome,) = run(suite(replace(case(), protocol=learned)), tmp_path)
    assert fault in outcome.result.error
    assert not (outcome.folder / "curve.jsonl").exists()


def test_a_held_out_photo_that_cannot_be_read_is_named_before_training(tmp_path, monkeypatch):
    """Nothing reads it in training: it was found after all of it, and nothing was scored."""
    folder = write_scene(tmp_path / "flight", Flight(views=3, points=30))
    Image.new("CMYK", (96, 72)).save(folder / "photos" / view_name(0), format="JPEG")
    rules = Protocol(name="rules", source="test", hold=2)
    monkeypatch.setattr(cases, "open_scene", lambda spec, protocol: open_scene(folder, rules))
    (outcome,) = run(suite(case()), tmp_path / "runs")
    assert "photo_000.png: pixel format is CMYK, expected" in outcome.result.error
    assert not (outcome.folder / "curve.jsonl").exists()


def test_an_error_that_is_not_ours_is_one_line_with_its_type(tmp_path, monkeypatch):
    def fit(*_: object) -> NoReturn:
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=fit))
    (outcome,) = run(suite(case()), tmp_path)
    assert outcome.result.error == "RuntimeError: first line second line"


@pytest.mark.parametrize(
    ("tell", "said"),
    [
        (
            lambda run: run.on_fact("rate", 0.1),
            "record of method fake: .*environment.rate: .*'0.1'",
        ),
        (lambda run: run.report(1, 2, {"loss": "low"}), "the reported 'loss' is 'low', expected a"),
        (lambda run: run.on_stage("train", float("nan")), "method fake: stage 'train' took nan s"),
    ],
)
def test_what_a_method_tells_of_another_type_fails_its_case_only(tmp_path, monkeypatch, tell, said):
    def fit(scene, settings, run):
        if run.seed == 0:
            tell(run)
        return fake_methods.fit(scene, settings, run)

    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=fit))
    failed, finished = run(suite(case(), case(seed=1)), tmp_path)
    assert finished.status == "finished"
    assert re.search(said, failed.result.error)


class Painted(ExplicitModel):
    """Draws otherwise than what it stores."""


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (None, "method fake: fit returned a NoneType, expected a Reconstruction"),
        (
            Painted(model=random_gaussians(3, degree=0)),
            "method fake: fit returned a Painted of kind 'explicit', which is loaded as a ExplicitModel",
        ),
    ],
)
def test_a_model_that_would_be_scored_as_another_is_refused(tmp_path, monkeypatch, returned, said):
    method = replace(METHODS["fake"], fit=lambda *_: returned)
    monkeypatch.setitem(METHODS, "fake", method)
    for _ in range(2):  # also where it was tried before
        (outcome,) = run(suite(case()), tmp_path)
        assert outcome.result.error.startswith(said)


@pytest.mark.parametrize("name", ["", "a/b", "../a", "a@b", "two words"])
def test_a_method_whose_name_is_no_folder_or_a_variants_is_refused(name):
    with pytest.raises(UsageError, match="expected letters, digits"):
        replace(METHODS["fake"], name=name)


class Plain:
    iterations = 1


@dataclass
class Loose:
    iterations: int = 1


@dataclass(frozen=True)
class Asking:
    iterations: int


@pytest.mark.parametrize(
    ("kind", "said"),
    [(Plain, "a frozen dataclass"), (Loose, "a frozen dataclass"), (Asking, "iterations has none")],
)
def test_a_method_with_settings_of_another_kind_is_refused(kind, said):
    with pytest.raises(UsageError, match=f"method fake: its settings are .*{said}"):
        replace(METHODS["fake"], settings=kind)


def test_a_method_that_changes_the_current_folder_moves_nothing(tmp_path, monkeypatch):
    elsewhere, here = tmp_path / "elsewhere", tmp_path / "here"
    elsewhere.mkdir()
    here.mkdir()

    def fit(*given):
        os.chdir(elsewhere)
        return fake_methods.fit(*given)

    monkeypatch.chdir(here)
    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=fit))
    (outcome,) = run(suite(case()), "runs")
    assert outcome.status == "finished"
    assert list(elsewhere.iterdir()) == []
    assert Path.cwd() == here


def test_progress_tells_every_stage_in_order(tmp_path):
    seen = []
    run(suite(case()), tmp_path, on_progress=seen.append)
    stages = list(dict.fromkeys(progress.stage for progress in seen))
    assert stages == ["start", "load", "init", "train", "save", "score"]
    steps = [progress.step for progress in seen if progress.stage == "train"]
    assert steps == list(range(1, 41))
    assert {(progress.index, progress.count) for progress in seen} == {(0, 1)}


def test_training_that_had_ended_is_not_repeated(tmp_path, monkeypatch):
    def stop(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(cases, "score_views", stop)
        with pytest.raises(KeyboardInterrupt):
            run(suite(case()), tmp_path)
    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=stop))
    (outcome,) = run(suite(case()), tmp_path)
    assert outcome.status == "finished"
    assert outcome.result.curve[-1][0] == 40


def test_what_other_code_has_begun_goes_on_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(case_folder, "git_commit", lambda: "older")
    run(suite(case(fail_with="stop")), tmp_path)
    monkeypatch.setattr(case_folder, "git_commit", lambda: "newer")
    notes = list[str]()
    (outcome,) = run(
        suite(case(fail_with="stop")), tmp_path, on_progress=lambda at: notes.append(at.note)
    )
    assert any("begun by other code (older)" in note for note in notes)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    whole = tmp_path / "whole"
    with monkeypatch.context() as patch:
        patch.setattr(cases, "score_views", stop)
        with pytest.raises(KeyboardInterrupt):
            run(suite(case()), whole)
    assert "begun by" not in run(suite(case()), whole)[0].result.environment
    (whole / "tiny/town/fake/default/seed0/record.json").unlink()
    monkeypatch.setattr(case_folder, "git_commit", lambda: "newest")
    assert run(suite(case()), whole)[0].result.environment["begun by"] == "newer"
    (outcome,) = run(suite(case()), whole, resume=False)
    assert "begun by" not in outcome.result.environment


def test_select_by_pattern_and_seeds():
    whole = suite(case(), case("village"))
    assert [c.label for c in select(whole, only="town/*").cases] == ["town/fake/default/seed0"]
    assert [c.seed for c in select(whole, seeds=3).cases] == [0, 1, 2, 0, 1, 2]
    both = select(select(whole, seeds=2), only="*/seed1").cases
    assert [c.scene for c in both] == ["town", "village"]
    with pytest.raises(UsageError, match=r"--only 'x\*' matches none of the 2 cases"):
        select(whole, only="x*")
    with pytest.raises(UsageError, match="--seeds is 0, expected from 1 to"):
        select(whole, seeds=0)


def test_two_runs_do_not_share_a_folder(tmp_path):
    with locked(tmp_path / "tiny/.lock"), pytest.raises(UsageError, match="`bench` is at work"):
        run(suite(case()), tmp_path)
    run(suite(case()), tmp_path)


def test_a_worker_gives_the_numbers_of_this_process(first, tmp_path):
    launch = partial(in_worker, target=run_fake_case)
    seen = []
    (apart,) = run_suite(
        suite(case()), tmp_path / "a", backend="reference", launch=launch, on_progress=seen.append
    )
    assert apart.status == "finished"
    assert apart.result.images == first.images
    assert [p.step for p in seen if p.stage == "train"] == list(range(1, 41))


TALKS = """
import sys
from functools import partial
from helpers import fake_methods
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_worker

if __name__ == "__main__":
    fake_methods.register()
    case = Case(
        scene="town", method="fake", settings=fake_methods.FakeSettings(), seed=0,
        protocol=load_protocol("default"),
    )
    suite = Suite(name="tiny", description="", cases=(case,), scenes=("town",))
    launch = partial(in_worker, target=fake_methods.run_talking_case)
    run_suite(suite, sys.argv[1], backend="reference", launch=launch)
    print("a result")
"""


def test_what_a_method_prints_is_no_result(tmp_path):
    script = tmp_path / "talks.py"
    script.write_text(TALKS)
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "runs")], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": path}, check=True, timeout=300,
    )  # fmt: skip
    assert done.stdout == "a result\n"
    assert "a method's own words" in done.stderr


def test_a_worker_that_dies_without_a_word_fails_its_case_only(tmp_path):
    launch = partial(in_worker, target=run_fake_case)
    those = suite(case(crash=True), case(seed=1))
    outcomes = run_suite(those, tmp_path, backend="reference", launch=launch)
    assert [outcome.status for outcome in outcomes] == ["failed", "finished"]
    assert "left no record: it ended with exit code 7" in outcomes[0].result.error


def test_a_case_is_over_though_a_thread_of_its_method_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "AT_REST", 0.1)
    launch = partial(in_worker, target=fake_methods.run_case_that_leaves_a_thread)
    (outcome,) = run(suite(case()), tmp_path, launch=launch)
    assert outcome.status == "finished"


def test_a_worker_that_cannot_write_its_record_prints_no_traceback(tmp_path, capfd):
    launch = partial(in_worker, target=fake_methods.run_on_a_full_disk)
    (outcome,) = run(suite(case()), tmp_path, launch=launch)
    assert "left no record: it ended with exit code 1" in outcome.result.error
    assert capfd.readouterr().err == ""


def test_a_failure_without_room_for_its_traceback_is_recorded(tmp_path, monkeypatch):
    def full(path: Path, text: str) -> None:
        if path.name == "failure.txt":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        write_text(path, text)

    monkeypatch.setattr(cases, "write_text", full)
    (outcome,) = run(suite(case(fail_with="stop")), tmp_path)
    assert outcome.result.error == "stop"


def test_records_are_strict_json_lines(tmp_path):
    (outcome,) = run(suite(case()), tmp_path)
    lines = Path(outcome.folder / "record.json").read_text().splitlines()
    assert len(lines) == 1
    assert json.loads(lines[0])["scene"] == "town"
