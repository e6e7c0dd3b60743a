"""What a command of the face prints for machines."""

import json
from pathlib import Path

import pytest

from splatproof.cli import main
from splatproof.suites.records import read_finished


def rows_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> list[dict]:
    """What a command that succeeds prints for machines."""
    assert main([*arguments, "--json", "--quiet"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def processor_seconds(out: Path) -> float:
    """What the cases below a folder took, each training once, whatever else the machine did meanwhile."""
    taken = {result.model_sha256: result.cpu_seconds for result in read_finished(out)}
    return sum(taken.values())


def judged_in_reduced_form(
    suite: str, out: Path, capsys: pytest.CaptureFixture[str]
) -> dict[str, str]:
    """Reasons by claim of `bench claims --run --quick` on a suite whose reduced form has just run.

    Nothing is left to run, and nothing may be judged: one seed of a few steps.
    """
    before = sorted(out.rglob("record.json"))
    stamps = [path.stat().st_mtime_ns for path in before]
    found = rows_of(["claims", "--run", "--quick", "--suite", suite, "--out", str(out)], capsys)
    assert sorted(out.rglob("record.json")) == before
    assert [path.stat().st_mtime_ns for path in before] == stamps
    assert {one["verdict"] for one in found} <= {"too short to judge", "not testable here"}
    return {one["text"]: one["reason"] for one in found}
