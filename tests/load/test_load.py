"""Large inputs stay inside their bounds of time and memory."""

import time

from helpers.colmap_scenes import Flight, write_scene
from splatproof.cli import main

CASES = 2_000
SECONDS = 5.0
"""Processor time in which a suite of CASES is planned."""
SUITE = """description = "Many"
[[cases]]
scenes = ["./town"]
methods = ["3dgs"]
protocols = ["default"]
seeds = [{}]
"""


def test_a_suite_of_many_cases_is_planned(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "town", Flight(views=3, points=12))
    seeds = ", ".join(map(str, range(CASES)))
    (tmp_path / "many.toml").write_text(SUITE.format(seeds))
    assert (
        main(["run", "many.toml", "--dry-run", "--json", "--only", "town/3dgs/default/seed0"]) == 0
    )  # imports
    capsys.readouterr()
    begun = time.process_time()
    assert main(["run", "many.toml", "--dry-run", "--json"]) == 0
    seconds = time.process_time() - begun
    assert len(capsys.readouterr().out.splitlines()) >= CASES
    assert seconds < SECONDS
