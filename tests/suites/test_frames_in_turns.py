"""Saved models of finished cases are drawn in turns, and their records then say what a frame took."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.base.errors import DataError
from splatproof.methods.registry import METHODS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import frames_in_turns, run_case
from splatproof.suites.frames_in_turns import draw_in_turns, finished_cases, in_turns
from splatproof.suites.records import read_record, write_record
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

PROTOCOL = load_protocol("default")
CASES = tuple(
    Case(
        scene=scene,
        method="fake",
        settings=FakeSettings(iterations=3),
        seed=seed,
        protocol=PROTOCOL,
    )
    for scene in ("town", "village")
    for seed in (0, 1)
)
SUITE = Suite(name="tiny", description="For tests", cases=CASES, scenes=("town", "village"))


def fakes(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(METHODS, "fake", None)  # removed again after the test
    for module in (run_case, frames_in_turns):
        patch.setattr(module, "open_scene", fake_scene)
    fake_methods.register()


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    fakes(monkeypatch)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """What the suite leaves: each test gets a copy."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        fakes(patch)
        run_suite(SUITE, folder, backend="reference", launch=in_process)
    return folder


@pytest.fixture
def ran(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "ran")


def test_each_has_its_turn_in_each_round_and_another_one_begins():
    order: list[str] = []

    def drawn(name: str) -> float:
        order.append(name)
        return float(len(order))

    begun: list[int] = []
    found = in_turns({name: partial(drawn, name) for name in "abc"}, 4, begun.append)
    assert "".join(order) == "abcbcacababc"
    assert found == {"a": (1, 6, 8, 10), "b": (2, 4, 9, 11), "c": (3, 5, 7, 12)}
    assert begun == [0, 1, 2, 3]


def test_records_have_the_median_of_the_rounds_and_one_session_and_all_else_as_it_was(
    ran, monkeypatch
):
    times = iter([5.0, 50.0, 60.0, 6.0, 7.0, 70.0] + [1.0, 2.0] * 3)
    monkeypatch.setattr(frames_in_turns, "render_milliseconds", lambda *_: next(times))
    found = finished_cases(SUITE, ran)
    before = [read_record(one.folder) for one in found]
    rounds: list[tuple[str, int]] = []
    drawn = draw_in_turns(found, 3, lambda place, number: rounds.append((place, number)))
    assert rounds == [(f"{name}, default", i) for name in ("town", "village") for i in range(3)]
    assert [one.before.case for one in drawn] == list(CASES)
    assert drawn[0].rounds == (5.0, 6.0, 7.0)
    assert [one.result.render_ms for one in drawn] == [6.0, 60.0, 1.0, 2.0]
    (session,) = {one.result.turns for one in drawn}
    assert session
    for one, old in zip(drawn, before, strict=True):
        assert read_record(one.before.folder) == one.result
        assert replace(one.result, render_ms=old.render_ms, turns="") == old
    monkeypatch.setattr(frames_in_turns, "render_milliseconds", lambda *_: 1.0)
    assert draw_in_turns(found, 3)[0].result.turns != session


def test_models_are_drawn_in_earnest_and_a_finished_case_stays_finished(ran):
    (one, *_) = draw_in_turns(finished_cases(SUITE, ran), 3)
    assert 0 < min(one.rounds) <= one.result.render_ms <= max(one.rounds) < 1e4
    again = run_suite(SUITE, ran, backend="reference", launch=in_process)
    assert {outcome.status for outcome in again} == {"kept"}
    assert again[0].result == one.result


def test_what_failed_or_was_not_run_has_no_turn(ran):
    first, second, *_ = finished_cases(SUITE, ran)
    write_record(first.folder, replace(first.result, error="it broke"))
    assert finished_cases(SUITE, ran)[0].folder == second.folder
    with pytest.raises(
        DataError, match=r"tiny: 1 of 2 cases have a result here, and turns take two"
    ):
        finished_cases(replace(SUITE, cases=CASES[:2]), ran)
    with pytest.raises(DataError, match="0 of 4 cases .*`bench run tiny` makes them"):
        finished_cases(SUITE, ran / "elsewhere")


def test_nothing_is_written_where_a_model_cannot_be_read(ran):
    found = finished_cases(SUITE, ran)
    for path in (found[-1].folder / "model").iterdir():
        path.unlink()
    with pytest.raises(DataError):
        draw_in_turns(found, 3)
    assert [read_record(one.folder) for one in found] == [one.result for one in found]
