"""bench frames: times of saved models in turns, from arguments to records and lines."""

import json
import shutil
from functools import partial

import pytest

from helpers import fake_methods
from helpers.fake_methods import fake_scene
from splatproof.cli import main, report
from splatproof.methods.registry import METHODS
from splatproof.suites import frames_in_turns, runner
from splatproof.suites import run_case as cases
from splatproof.suites.records import read_record
from splatproof.suites.workers import in_process

SUITE = """
description = "For tests"
[[cases]]
scenes = ["./town"]
methods = ["fake"]
protocols = ["default"]
seeds = [0, 1]
[cases.settings.fake]
iterations = 3
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a suite file of the fake method and its finished cases in runs/; for reading alone."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "fake", None)
        for module in (cases, frames_in_turns):
            patch.setattr(module, "open_scene", fake_scene)
        patch.setattr(runner, "run_suite", partial(runner.run_suite, launch=in_process))
        patch.setattr(report, "sync_cases", lambda out, uri: False)
        patch.chdir(folder)
        fake_methods.register()
        (folder / "town").mkdir()
        (folder / "mine.toml").write_text(SUITE)
        assert main(["run", "mine.toml", "--backend", "reference", "--quiet"]) == 0
        yield folder


def test_every_case_has_a_line_and_its_record_the_same_number(
    finished, tmp_path, capsys, monkeypatch
):
    synced: list[object] = []
    monkeypatch.setattr(report, "sync_cases", lambda out, uri: synced.append(out) or False)
    folder = shutil.copytree(finished, tmp_path / "copy")
    monkeypatch.chdir(folder)
    assert main(["frames", "mine.toml", "--rounds", "3", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["method"], line["seed"]) for line in lines] == [("fake", 0), ("fake", 1)]
    for line in lines:
        result = read_record(folder / f"runs/mine/town/fake/default/seed{line['seed']}")
        assert line["render_ms"] == result.render_ms == sorted(line["rounds"])[1]
        assert result.turns
    assert [str(out) for out in synced] == ["runs/mine"]  # the store hears of it
    assert main(["frames", "mine.toml", "--rounds", "3", "--threads", "1"]) == 0
    said = capsys.readouterr().out
    assert "ms  town/fake/default/seed1" in said
    assert f"it was {lines[1]['render_ms']:.2f}" in said


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--rounds", "2"], "--rounds is 2, expected from 3"),
        (["--threads", "0"], "--threads is 0, expected from 1"),
        (["--only", "*/seed1"], "1 of 1 cases have a result here, and turns take two"),
        (["--only", "*/seed7"], "matches none of the 2 cases"),
        (["--out", "nowhere"], "nowhere/mine: 0 of 2 cases have a result here"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_one_line_and_leaves_nothing(
    finished, capsys, monkeypatch, arguments, told
):
    monkeypatch.chdir(finished)
    before = {path: path.read_bytes() for path in finished.rglob("record.json")}
    assert main(["frames", "mine.toml", *arguments]) == 2
    said = capsys.readouterr()
    assert told in said.err
    assert not said.out
    assert not (finished / "nowhere").exists()
    assert {path: path.read_bytes() for path in finished.rglob("record.json")} == before
