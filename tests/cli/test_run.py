"""bench run from arguments to files, exit codes and leaderboard."""

import json
import os
import pty
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from helpers import fake_methods
from helpers.empty_store import lay_empty_store
from helpers.fake_methods import fake_scene
from splatproof.cli import main, report
from splatproof.methods.registry import METHODS
from splatproof.suites import environment, estimate, held_out, runner
from splatproof.suites import run_case as cases
from splatproof.suites.workers import in_process

SUITE = """
description = "For tests"
[[cases]]
scenes = ["./town"]
methods = ["fake"]
protocols = ["default"]
seeds = [0, 1]
[cases.settings.fake]
iterations = 6
"""


@pytest.fixture
def suite(tmp_path, monkeypatch):
    """A suite file of the fake method, whose cases run in this process."""
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    monkeypatch.setattr(estimate, "open_scene", fake_scene)
    monkeypatch.setattr(runner, "run_suite", partial(runner.run_suite, launch=in_process))
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # 15 were a third of what a case takes
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    fake_methods.register()
    (tmp_path / "town").mkdir()
    path = tmp_path / "mine.toml"
    path.write_text(SUITE)
    return path


@pytest.fixture
def no_store(monkeypatch):
    """Cases are not logged: a new database takes seconds."""
    monkeypatch.setattr(report, "sync_cases", lambda out, uri: False)


def bench_run(*arguments: object) -> int:
    return main(["run", *map(str, arguments), "--backend", "reference"])


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def test_a_suite_runs_once_and_prints_its_leaderboard(suite, capsys):
    assert bench_run(suite) == 0
    said = capsys.readouterr()
    assert "mine · town · default" in said.out
    assert "fake" in said.out
    assert "[2/2] town/fake/default/seed1" in said.err
    assert (suite.parent / "runs/mine/town/fake/default/seed1/record.json").exists()
    assert (suite.parent / "runs/mlflow.db").exists()
    assert bench_run(suite, "--json", "--quiet") == 0
    said = capsys.readouterr()
    assert said.err == ""
    kept = lines(said.out)
    assert [record["status"] for record in kept] == ["kept", "kept"]
    assert {"suite", "scene", "method", "protocol", "seed", "psnr", "error"} <= set(kept[0])


@pytest.mark.usefixtures("no_store")
def test_choosing_and_starting_over(suite, capsys):
    chosen = [suite, "--only", "*/seed2", "--seeds", 3, "--json"]
    for extra, status in (([], "finished"), (["--resume"], "kept"), (["--no-resume"], "finished")):
        assert bench_run(*chosen, *extra) == 0
        (record,) = lines(capsys.readouterr().out)
        assert (record["seed"], record["status"]) == (2, status)


@pytest.mark.usefixtures("no_store")
def test_a_model_is_taken_of_a_case_that_was_chosen_another_time(suite, capsys):
    suite.with_name("half.toml").write_text('source = "tests"\nregion = "right_half"\n')
    suite.write_text(SUITE.replace('["default"]', '["default", "./half.toml"]'))
    for protocol, trained in (("default", False), ("half", True)):
        assert bench_run(suite, "--only", f"*/{protocol}/seed1", "--json") == 0
        (record,) = lines(capsys.readouterr().out)
        told = json.loads((Path(record["folder"]) / "record.json").read_text())
        assert ("trained in" in told["environment"]) == trained


@pytest.mark.usefixtures("no_store")
def test_results_that_another_commit_made_are_kept_and_said_to_be_old(suite, capsys, monkeypatch):
    def at(commit: str, *options: str) -> str:
        monkeypatch.setattr(environment, "git_commit", lambda: commit)
        assert bench_run(suite, "--quiet", *options) == 0
        return capsys.readouterr().err

    old, new = 40 * "a", 40 * "b"
    assert at(old, "--only", "*/seed0") == ""
    assert at(old) == ""
    said = at(new)
    assert said.startswith(f"bench: 2 of 2 results were kept and are of commit {old[:10]}, while")
    assert f"this code is {new[:10]}; another --out, or --no-resume" in said
    assert at("") == ""
    assert at(new, "--no-resume") == ""
    assert at(new) == ""


@pytest.mark.usefixtures("no_store")
def test_a_failed_case_is_told_and_the_exit_code_is_1(suite, capsys):
    suite.write_text(SUITE.replace("iterations = 6", 'iterations = 6\nfail_with = "no sky"'))
    assert bench_run(suite, "--json", "--quiet") == 1
    said = capsys.readouterr()
    assert [record["status"] for record in lines(said.out)] == ["failed", "failed"]
    assert said.err.count("no sky") == 2
    folder = "runs/mine/town/fake/default"
    assert f"(traceback: {folder}/seed1/failure.txt)" in said.err


def test_a_dry_run_prints_estimates_and_leaves_nothing(suite, capsys):
    assert bench_run(suite, "--dry-run", "--json") == 0
    plan = lines(capsys.readouterr().out)
    assert len(plan) == 2
    assert all(case["estimated_seconds"] > 0 < case["estimated_memory_mb"] for case in plan)
    assert bench_run(suite, "--dry-run") == 0
    assert "town/fake/default/seed1" in capsys.readouterr().out
    assert not (suite.parent / "runs").exists()


def test_a_dry_run_makes_no_scene_computes_no_points_and_writes_nothing(
    suite, capsys, monkeypatch, tmp_path
):
    opened = []

    def opens(spec, protocol):
        opened.append((spec, protocol.points))
        return fake_scene(spec, protocol)

    monkeypatch.setattr(estimate, "open_scene", opens)
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path / "no data"))
    (tmp_path / "points.toml").write_text('source = "ours"\npoints = "triangulated"\n')
    three = SUITE.replace('"./town"', '"./town", "courtyard", "seneca"')
    suite.write_text(three.replace('"default"', '"./points.toml"'))
    before = sorted(tmp_path.rglob("*"))
    assert bench_run(suite, "--dry-run", "--json") == 0
    said = capsys.readouterr()
    plan = {case["scene"]: case for case in lines(said.out)}
    assert plan["town"]["estimated_seconds"] > 0
    assert plan["courtyard"]["estimated_seconds"] is plan["seneca"]["estimated_seconds"] is None
    assert plan["courtyard"]["basis"] == "scene not made yet"
    assert plan["courtyard"]["missing"] == ""
    assert plan["seneca"]["basis"] == "scene not on this machine"
    assert "seneca: not on this machine" in plan["seneca"]["missing"]
    assert "2 wait for scenes to be made and have no estimate, 2 cannot run here" in said.err
    assert opened == [(str(tmp_path / "town"), "scene")]
    assert bench_run(suite, "--dry-run") == 0
    assert "not made  courtyard/fake/points/seed0" in capsys.readouterr().out
    assert sorted(tmp_path.rglob("*")) == before


def test_a_store_that_is_away_does_not_stop_the_run(suite, capsys, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    assert bench_run(suite) == 0
    said = capsys.readouterr()
    assert "mine · town · default" in said.out
    assert "the records are on disk" in said.err


@pytest.mark.usefixtures("no_store")
def test_an_optional_scene_that_is_not_here_is_left_out_with_a_reason(suite, capsys, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_DATA", str(suite.parent))
    two = SUITE.replace('"./town"', '"./town", "seneca"')
    suite.write_text('optional_scenes = ["seneca"]\n' + two)
    assert bench_run(suite, "--json") == 0
    said = capsys.readouterr()
    assert {record["scene"] for record in lines(said.out)} == {"town"}
    assert "left out: seneca: not on this machine" in said.err
    suite.write_text(two)
    assert bench_run(suite, "--out", "other") == 3
    assert not (suite.parent / "other").exists()


def changed(old: str, new: str) -> str:
    assert old in SUITE
    return SUITE.replace(old, new)


BAD_FILES = {
    "cut": (SUITE[:40], "not a TOML file"),
    "unknown key": (changed("seeds", "seed"), "did you mean 'seeds'"),
    "unknown method": (changed('"fake"', '"fakee"'), "did you mean 'fake'"),
    "unknown protocol": (changed('"default"', '"defualt"'), "'default'"),
    "unknown setting": (changed("iterations", "iteration"), "did you mean 'iterations'"),
    "wrong type": (changed("= 6", '= "6"'), "iterations"),
    "wrong value": (changed("= 6", "= -6"), "iterations is -6"),
    "unknown scene": (changed('"./town"', '"brighton_beech"'), "'brighton_beach'"),
    "no such folder": (changed('"./town"', '"./twon"'), "no such scene folder"),
    "no such protocol file": (changed('"default"', '"./x.toml"'), "x.toml"),
    "negative seed": (changed("[0, 1]", "[-1]"), "-1"),
}
BAD_ARGUMENTS = {
    "unknown suite": (["qiuck"], "did you mean 'quick'"),
    "study": (["stability"], "stability is a study, not a suite: run `bench study stability`"),
    "nearly a study": (["stabilty"], "did you mean `bench study stability`?"),
    "no reduced form": (["brighton", "--quick"], "suite 'brighton' has no reduced form"),
    "no such file": (["nothing.toml"], "no such suite file"),
    "nothing chosen": (["mine.toml", "--only", "x/*"], "matches none"),
    "no seeds": (["mine.toml", "--seeds", "0"], "--seeds is 0, expected from 1 to"),
    "unknown backend": (["mine.toml", "--backend", "cpuu"], "did you mean 'cpu'"),
}


@pytest.mark.parametrize("name", [*BAD_FILES, *BAD_ARGUMENTS, "store"])
def test_bad_input_is_one_line_exit_2_and_leaves_nothing(suite, capsys, monkeypatch, name):
    arguments, message = [str(suite)], "mlflow"
    if name in BAD_FILES:
        text, message = BAD_FILES[name]
        suite.write_text(text)
    elif name in BAD_ARGUMENTS:
        arguments, message = BAD_ARGUMENTS[name]
    else:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", "file:///mlruns")
    if "--backend" not in arguments:
        arguments = [*arguments, "--backend", "reference"]
    before = sorted(suite.parent.iterdir())
    assert main(["run", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert message in said.err
    assert sorted(suite.parent.iterdir()) == before


def test_results_reach_a_pipe_while_a_bar_is_on_the_terminal():
    program = (
        "from splatproof.cli import output\n"
        "with output.progress() as bar:\n"
        "    bar.add_task('x', total=2, values='')\n"
        "    output.print_record({'psnr': 1.0})\n"
    )
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm"}
    done = subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=theirs, env=environment,
        check=True,
    )  # fmt: skip
    os.close(theirs)
    shown = os.read(ours, 10_000)
    os.close(ours)
    assert done.stdout == b'{"psnr": 1.0}\n'
    assert b"x" in shown


def test_the_leaderboard_of_a_folder_is_that_of_the_store(suite, capsys):
    lay_empty_store(suite.parent / "runs")
    assert bench_run(suite, "--quiet") == 0
    first = capsys.readouterr().out
    assert main(["report", "--quiet"]) == 0
    again = capsys.readouterr().out
    rows = [line for line in first.splitlines() if " fake " in line]
    assert rows
    assert set(rows) <= set(again.splitlines())
    assert Path("runs/report.html").exists()
