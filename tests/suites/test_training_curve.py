"""The curve of a run that was killed and continued is that of an undisturbed one."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatproof.suites import training_curve as curve_module
from splatproof.suites.training_curve import POINTS, Curve


def log(curve: Curve, start: int, stop: int, total: int, every: int) -> None:
    for step in range(start + 1, stop + 1):
        if step % every == 0 or step == total:
            curve.add(step, total, {"loss": 1 / step})


@given(
    total=st.integers(1, 3000),
    every=st.sampled_from([1, 7, 10]),
    kill=st.floats(0, 1),
    back=st.floats(0, 1),
    torn=st.booleans(),
)
def test_continued_equals_undisturbed(tmp_path_factory, total, every, kill, back, torn):
    folder = tmp_path_factory.mktemp("curve")
    whole = Curve(folder / "whole.jsonl")
    log(whole, 0, total, total, every)
    killed = int(kill * total)
    log(Curve(folder / "torn.jsonl"), 0, killed, total, every)
    if torn:
        with (folder / "torn.jsonl").open("a") as file:
            file.write('{"step": 1')
    continued = Curve(folder / "torn.jsonl")
    log(continued, int(back * killed), total, total, every)
    assert continued.points() == whole.points()
    assert Curve(folder / "torn.jsonl").points() == whole.points()
    assert len(whole.points()) <= 2 * POINTS
    assert whole.points()[-1][0] == total


def test_cpu_time_and_memory_of_lost_steps_do_not_count(tmp_path, monkeypatch):
    clock, peak = [100.0], [50.0]
    monkeypatch.setattr(curve_module, "cpu_seconds", lambda: clock[0])
    monkeypatch.setattr(curve_module, "peak_memory_mb", lambda: peak[0])
    first = Curve(tmp_path / "c.jsonl")
    for step in (1, 2, 3):
        clock[0] += 10
        first.add(step, 10, {})
    assert first.spent() == (30.0, 50.0)
    # Killed; the checkpoint was at step 2. A new process starts its clock anew.
    clock[0], peak[0] = 1.0, 40.0
    second = Curve(tmp_path / "c.jsonl")
    clock[0] += 10
    second.add(3, 10, {})
    assert second.spent() == (30.0, 50.0)
    assert [step for step, _ in second.points()] == [1, 2, 3]


def test_seconds_of_lost_steps_and_of_the_pause_do_not_count(tmp_path, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(curve_module.time, "perf_counter", lambda: clock[0])
    first = Curve(tmp_path / "c.jsonl")
    for step in (1, 2, 3):
        clock[0] += step
        first.add(step, 10, {})
    assert first.seconds() == (1.0, 3.0, 6.0)
    clock[0] = 5000.0  # killed, continued from step 2 by another process
    second = Curve(tmp_path / "c.jsonl")
    clock[0] += 4
    second.add(3, 10, {})
    assert second.seconds() == Curve(tmp_path / "c.jsonl").seconds() == (1.0, 3.0, 7.0)


def test_a_curve_that_an_earlier_release_began_has_no_seconds(tmp_path):
    line = '{"step": 1, "values": {}, "cpu_seconds": 1.0, "peak_memory_mb": 1.0}'
    (tmp_path / "c.jsonl").write_text(line + "\n")
    curve = Curve(tmp_path / "c.jsonl")
    curve.add(10, 10, {})
    assert len(curve.points()) == 2
    assert curve.seconds() == ()


def test_training_that_had_ended_reports_nothing_and_keeps_its_points(tmp_path, monkeypatch):
    monkeypatch.setattr(curve_module, "cpu_seconds", lambda: 5.0)
    Curve(tmp_path / "c.jsonl").add(1, 1, {"loss": 0.5})
    again = Curve(tmp_path / "c.jsonl")
    assert again.points() == ((1, {"loss": 0.5}),)
    assert again.spent()[0] == pytest.approx(0.0)
