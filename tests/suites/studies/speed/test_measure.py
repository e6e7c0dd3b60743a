"""The speed study: every registered twin against its float64 reference, times, refusals, pictures."""

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof import _ext
from splatproof.base.errors import SplatproofError, UsageError
from splatproof.suites.studies.speed import idle
from splatproof.suites.studies.speed import judge as speed_judge
from splatproof.suites.studies.speed import measure as speed
from splatproof.suites.studies.speed import neural as speed_neural
from splatproof.suites.studies.speed import plot as speed_plot
from splatproof.suites.studies.speed import roofline as speed_roofline
from splatproof.suites.studies.speed.measure import Timer
from splatproof.suites.studies.speed.session import Here, Process, Task
from splatproof.suites.studies.study import STUDIES
from splatproof.suites.twins.random_scenes import speed_scene
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Case, Component, Problem, Twin, functional

TWINS = [
    pytest.param(component, twin, id=f"{name}: {twin.name}")
    for name, component in COMPONENTS.items()
    if component.reference is not None
    for twin in component.twins
]
KEYS = {"component", "twin", "case", "forward_ms", "backward_ms", "max_abs_error", "grad_rel_l2",
        "discontinuity_pixels", "peak_mb"}  # fmt: skip


@pytest.mark.parametrize(("component", "twin"), TWINS)
def test_every_registered_twin_keeps_its_budget(component: Component, twin: Twin):
    alone = replace(component, twins=(twin,))
    found = speed_judge.judge(alone, component.problem(component.tiny))[twin.name]
    assert found["ok"], found
    if not twin.approximates:
        assert found["max_abs_error"] <= component.max_abs_error
        assert (found["grad_cosine"] or 1.0) > 0.9999


@pytest.mark.parametrize("component", COMPONENTS.values(), ids=COMPONENTS)
def test_the_usual_twin_exists_and_names_are_unique(component: Component):
    names = [twin.name for twin in component.twins]
    assert component.usual in names
    assert len(set(names)) == len(names)
    assert (
        any(case.quick for case in component.cases)
        or component.reference is None
        or (component.name == "soft rank")
    )


def line(problem: str = "") -> Component:
    """y = sum of x^2 of ten numbers; the twin is as it should be but for the planted fault."""

    def fault(leaves, _):
        x = leaves["x"]
        value = (x * x).sum()[None]
        return {
            "": lambda: value,
            "1 % off": lambda: value * 1.01,
            "sign": lambda: -value,
            "NaN": lambda: value * torch.nan,
            "gradient lost": lambda: value.detach() + 0 * x.sum(),
        }[problem]()

    def exact(leaves, _):
        return (leaves["x"] ** 2).sum()[None]

    return Component(
        name="line", usual="twin", judged=(10,), tiny=(10,), cases=(Case(size=(20,), quick=True),),
        problem=lambda size: Problem(
            leaves={"x": torch.linspace(0.1, 1, size[0])}, cotangent=torch.ones(1)
        ),
        reference=Twin(name="truth", start=functional(exact), dtype=torch.float64),
        twins=(Twin(name="twin", start=functional(fault)),),
    )  # fmt: skip


@pytest.mark.parametrize("fault", ["1 % off", "sign", "NaN", "gradient lost"])
def test_the_judge_sees_planted_errors(fault):
    assert speed_judge.judge(line(), line().problem((10,)))["twin"]["ok"]
    assert not speed_judge.judge(line(fault), line().problem((10,)))["twin"]["ok"]


@pytest.mark.parametrize(("fault", "ok"), [("1 % off", True), ("sign", True), ("NaN", False)])
def test_an_approximation_shows_its_error_and_must_be_finite(fault, ok):
    component = line(fault)
    rough = replace(component.twins[0], approximates="something")
    found = speed_judge.judge(replace(component, twins=(rough,)), component.problem((10,)))["twin"]
    assert found["ok"] is ok
    assert not found["max_abs_error"] < 0.01


@pytest.fixture
def only_line(monkeypatch) -> Iterator[None]:
    """The registry holds one small component; the roofline and steps of methods with networks are left out."""
    kept = dict(COMPONENTS)
    COMPONENTS.clear()
    COMPONENTS["line"] = line()
    monkeypatch.setattr(speed_roofline, "rows", lambda **_: iter(()))
    monkeypatch.setattr(speed_neural, "CASES", ())
    monkeypatch.setattr(speed, "ROUND_SECONDS", 0.01)
    monkeypatch.setattr(speed, "TURN_SECONDS", 0.01)
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.01)
    yield
    COMPONENTS.clear()
    COMPONENTS.update(kept)


def test_a_new_twin_appears_in_every_row(only_line):
    component = COMPONENTS["line"]
    more = replace(component.twins[0], name="another")
    COMPONENTS["line"] = replace(component, twins=(*component.twins, more))
    rows = list(speed.rows(quick=True, open_session=Here))
    assert [(row["twin"], row["case"]) for row in rows] == [
        ("twin", "10"), ("another", "10"), ("twin", "20"), ("another", "20")
    ]  # fmt: skip
    for row in rows:
        assert set(row) >= KEYS
        assert row["ok"]
        assert row["forward_ms"] > 0
        assert row["backward_ms"] > 0
        assert row["error_case"] == "10"


def test_a_disturbed_row_has_ratios_and_no_times_and_a_quiet_one_both(only_line, monkeypatch):
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.001)
    monkeypatch.setattr(speed, "BUSY_SECONDS", 0.2)
    monkeypatch.setattr(idle.Watch, "percent", lambda self: 40.0)
    rows = list(speed.rows(quick=False, wait=0.01, open_session=Here))
    assert {(row["forward_ms"], row["backward_ms"], row["ok"]) for row in rows} == {
        (None, None, True)
    }
    assert {(row["ratio_low"], row["ratio"], row["ratio_high"]) for row in rows} == {(1, 1, 1)}
    assert all("others used 40 % of a core" in row["note"] for row in rows)
    assert all(row["max_abs_error"] < 1e-6 for row in rows)  # errors need no idle machine
    monkeypatch.setattr(idle.Watch, "percent", lambda self: 4.0)
    assert all(row["ok"] and row["forward_ms"] > 0 and row["ratio"] == 1
               for row in speed.rows(quick=False, wait=0.0, open_session=Here))  # fmt: skip


def test_ratios_are_of_neighbouring_turns():
    """A machine that slows down tenfold between rounds: times say nothing, their ratios do."""
    rounds = [
        {
            "a": [(slow, 2 * slow)] * 3,
            "b": [(2 * slow, 5 * slow)],
            "forward": [(6 * slow, math.nan)],
        }
        for slow in (1.0, 10.0, 3.0)
    ]
    assert speed.ratios(rounds, "b", "a") == pytest.approx((7 / 3, 7 / 3, 7 / 3))
    assert speed.ratios(rounds, "forward", "a")[1] == pytest.approx(2.0)
    assert speed.ratios(rounds, "absent", "a") == (None, None, None)
    assert speed.ratios([], "a", "a") == (None, None, None)


@pytest.mark.parametrize(("rounds", "left_out"), [(2, 0), (5, 0), (6, 0), (9, 1), (15, 3)])
def test_an_interval_of_ratios_holds_the_median_as_often_as_it_says(rounds, left_out):
    turns = [{"a": [(1.0, math.nan)], "b": [(float(i), math.nan)]} for i in range(1, rounds + 1)]
    low, _, high = speed.ratios(turns, "b", "a")
    assert (low, high) == (1 + left_out, rounds - left_out)
    # scipy's table of the binomial, independently
    if rounds >= 6:
        from scipy.stats import binom

        assert (
            2 * binom.cdf(left_out, rounds, 0.5) <= 0.05 < 2 * binom.cdf(left_out + 1, rounds, 0.5)
        )


def test_one_case_alone_and_none_that_is_not_there(only_line):
    rows = list(speed.rows(quick=True, only="line/20", open_session=Here))
    assert [(row["case"], row["error_case"]) for row in rows] == [("20", "10")]
    assert len(list(speed.rows(quick=True, only="line", open_session=Here))) == 2
    assert list(speed.rows(quick=True, only="roofline", open_session=Here)) == []
    with pytest.raises(UsageError, match="line/10, line/20, roofline"):
        list(speed.rows(quick=True, only="lime/*", open_session=Here))


def test_cases_that_are_there_are_not_measured_again(only_line):
    kept = [
        row | {"forward_ms": 7.0}
        for row in speed.rows(quick=True, only="line/10", open_session=Here)
    ]
    rows = list(speed.rows(quick=True, kept=kept, open_session=Here))
    assert [row["case"] for row in rows] == ["10", "20"]
    assert rows[0] == kept[0]
    assert rows[1]["forward_ms"] != 7.0


def test_quiet_rounds_count_though_others_were_disturbed(only_line, monkeypatch):
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.001)
    shares = iter([0.0, 3.0, *[50.0] * 1000])
    monkeypatch.setattr(idle.Watch, "percent", lambda self: next(shares))
    first = next(speed.rows(quick=False, wait=0.0, open_session=Here))
    assert first["ok"]
    assert first["disturbed_percent"] == 3.0


def test_a_twin_that_cannot_start_is_a_row_and_the_others_are_timed(only_line):
    def broken(problem, leaves):
        raise SplatproofError("it is too large")

    component = COMPONENTS["line"]
    large = Twin(name="large", start=broken, approximates="x", most=0)
    good = Timer(quick=True, patience=idle.Patience(0.0), backend="", open_session=Here)
    COMPONENTS["line"] = replace(component, twins=(large, *component.twins))
    rows = list(good.case(COMPONENTS["line"], Case(size=(10,)), list(COMPONENTS["line"].twins)))
    assert [(row["twin"], row["ok"]) for row in rows] == [("large", False), ("twin", True)]
    assert rows[0]["note"] == "it is too large"
    assert rows[0]["forward_ms"] is None
    assert rows[1]["forward_ms"] > 0


def test_the_reduced_form_marks_what_was_disturbed(only_line, monkeypatch):
    monkeypatch.setattr(idle, "LOOK_SECONDS", 0.001)
    monkeypatch.setattr(idle.Watch, "percent", lambda self: 40.0)
    for row in speed.rows(quick=True, open_session=Here):
        assert row["forward_ms"] > 0
        assert row["note"] == "others used 40 % of a core"


def test_a_process_of_its_own_reports_its_own_memory():
    """500,000 numbers of 59 Gaussians each: values, gradient and moments are 472 MB in float32."""
    held = bytearray(300 * 2**20)
    session = Process(Task(component="adam", size=(500_000,), twin="cpu"))
    runs, memory = session.ask("turn", 0.0), session.ask("memory")
    session.close()
    assert len(held) > 0
    assert len(runs) == 1
    assert runs[0][0] > 0
    assert math.isnan(runs[0][1])
    assert 450 < memory["peak_mb"] < 1000
    # the update itself needs no memory; 64 MB for what libraries load with the first call
    assert memory["added_mb"] < 64


def test_a_session_leaves_threads_and_level_as_they_were():
    before = _ext.simd_level(), torch.get_num_threads()
    for name in ("cpu portable", "cpu, 1 thread"):
        session = Here(Task(component="rasterizer", size=(20, 16, 12), twin=name))
        session.ask("turn", 0.0)
        assert session.ask("pairs") > 0
        assert (_ext.simd_level(), torch.get_num_threads()) == before


def test_an_unknown_backend_is_refused():
    with pytest.raises(UsageError, match="compares cpu and cuda"):
        next(speed.rows(quick=True, backend="reference"))


def test_the_roofline_has_peaks_and_a_share_of_every_stage_at_every_level_of_vectors(monkeypatch):
    monkeypatch.setattr(speed_roofline, "QUICK_SIZE", (300, 64, 48))
    used = _ext.simd_level()
    every = list(speed_roofline.rows(quick=True, patience=idle.Patience(0.0)))
    levels = list(dict.fromkeys(row["level"] for row in every))
    assert levels[0] == used == _ext.simd_level()
    assert set(levels) == set(_ext.simd_levels()[1:] or _ext.simd_levels())
    for level in levels:
        rows = [row for row in every if row["level"] == level]
        peaks = {row["twin"]: row for row in rows if "value" in row}
        assert set(peaks) == {"multiply-adds", "blend forward", "blend backward", "memory"}
        assert all(row["value"] > 0 and row["case"].startswith(level) for row in peaks.values())
        stages = {row["twin"]: row for row in rows if "share" in row}
        assert set(stages) == {*_ext.stage_seconds(), "loss", "adam"}
        for row in stages.values():
            ms = row["backward_ms"] if row["forward_ms"] is None else row["forward_ms"]
            assert row["share"] == pytest.approx(row["floor_ms"] / ms)
            assert row["share"] > 0


def test_a_refused_roofline_says_so(monkeypatch):
    monkeypatch.setattr(idle.Watch, "percent", lambda self: 40.0)
    monkeypatch.setattr(speed_roofline, "measure_peak", lambda seconds: None)
    refused = list(speed_roofline.rows(quick=False, patience=idle.Patience(0.0)))
    assert len(refused) == len(_ext.simd_levels()[1:] or _ext.simd_levels())
    assert not any(row["ok"] for row in refused)
    assert all("refused" in row["note"] for row in refused)


points = st.lists(st.tuples(st.floats(1e-3, 1e3), st.floats(1e-9, 1.0)), min_size=1, max_size=20)


@given(points)
def test_the_frontier_is_what_nobody_beats(drawn):
    best = speed_plot.frontier(drawn)
    for time, error in best:
        assert not any(t <= time and e <= error and (t, e) != (time, error) for t, e in drawn)
    for time, error in drawn:
        assert any(t <= time and e <= error for t, e in best)


def test_pictures_are_drawn_of_rows_with_times_and_of_no_others(only_line, tmp_path):
    rows = list(speed.rows(quick=True, open_session=Here))
    rows += [row | {"twin": "b", "max_abs_error": 0.0} for row in rows]
    assert [path.name for path in speed_plot.draw(rows, tmp_path)] == ["pareto.png"]
    assert (tmp_path / "pareto.png").read_bytes()[:4] == b"\x89PNG"
    refused = [row | {"forward_ms": None} for row in rows]
    assert speed_plot.draw(refused, tmp_path) == []


@pytest.mark.slow
def test_the_reduced_study_holds_every_twin_that_has_a_quick_case():
    rows = list(speed.rows(quick=True))
    found = {(row["component"], row["twin"]) for row in rows}
    assert found >= {
        (name, twin.name)
        for name, component in COMPONENTS.items()
        if component.reference is not None
        for twin in component.twins
    }
    assert all(row["ok"] for row in rows)


def test_scenes_repeat_and_differ():
    one, again, other = (speed_scene(50, w, 24) for w in (32, 32, 33))
    assert torch.equal(one[0].sh, again[0].sh)
    assert torch.equal(one[1], again[1])
    assert not torch.equal(one[0].means, other[0].means)


def test_the_study_is_registered():
    assert STUDIES["speed"].rows is speed.rows
    assert KEYS - {"peak_mb"} <= set(STUDIES["speed"].columns)


def test_approximations_are_hollow_and_have_a_star():
    base = {"component": "rasterizer", "case": "c", "error_case": "c", "backward_ms": 1.0}
    rows = [
        base | {"twin": "cpu", "forward_ms": 1.0, "max_abs_error": 1e-7, "approximates": ""},
        base | {"twin": "rough", "forward_ms": 0.5, "max_abs_error": 1e-2, "approximates": "much"},
    ]
    figure = speed_plot.pareto(rows)
    assert figure is not None
    marks = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert marks["cpu"].get_markerfacecolor() != "none"
    assert marks["rough *"].get_markerfacecolor() == "none"
