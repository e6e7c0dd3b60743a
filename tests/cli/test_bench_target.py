"""`make bench`, without running it: a leaderboard of several rows, and what to do next."""

import shlex
import subprocess
from pathlib import Path

import pytest

from splatproof.cli import COMMANDS, main
from splatproof.suites.suite_files import load_suite

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def commands() -> list[list[str]]:
    """The commands of `bench` that make runs or prints, without the program's path."""
    said = subprocess.run(
        ["make", "-n", "bench"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.replace("'", " ")
    parts = [part for line in said.splitlines() for part in line.split("&&")]
    words = [shlex.split(part, comments=True) for part in parts]
    found = [[w.rsplit("/", 1)[-1] for w in line] for line in words]
    return [
        line[line.index("bench") + 1 :]
        for line in found
        if "bench" in line and "--help" not in line
    ]


def test_it_runs_a_suite_reports_it_and_names_the_next_commands(commands):
    assert [line[0] for line in commands] == ["run", "report", "ingest", "fit"]
    assert {line[0] for line in commands} <= set(COMMANDS)


def test_its_leaderboard_ranks_four_rows_on_a_scene_that_anybody_has(commands):
    suite = load_suite(commands[0][1])
    assert suite.cases[0].scene == "brighton_beach"
    rows = {case.row for case in suite.cases if case.scene == "courtyard"}
    assert len(rows) >= 4
    for row in rows:
        assert len([c for c in suite.cases if c.scene == "courtyard" and c.row == row]) >= 3
    assert "brighton_beach" in suite.optional_scenes
    assert suite.scenes == ()


def test_the_next_commands_take_the_options_they_are_printed_with(commands, tmp_path, capsys):
    for line in commands[2:]:
        own = {name: str(tmp_path / f"none_{name}") for name in ("PHOTOS", "my_scene", "my_model")}
        at = [own.get(str(word), str(word)) for word in line]
        assert main(at) == 2
        assert "none" in capsys.readouterr().err
