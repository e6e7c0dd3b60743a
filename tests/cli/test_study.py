"""Studies from the command line: rows, table, file, exit code."""

import json
from collections.abc import Iterator

import pytest

from splatbench.cli import main
from splatbench.suites.studies import study


@pytest.fixture
def tiny(monkeypatch):
    """A study of two rows; the second one fails unless quick."""

    def rows(*, quick: bool) -> Iterator[dict]:
        yield {"case": "needle", "error": 1e-7, "note": "", "ok": True}
        yield {"case": "disc", "error": float("nan"), "note": "", "ok": quick}

    made = study.Study(description="tiny", columns=("case", "error", "note", "ok"), rows=rows)
    monkeypatch.setitem(study.STUDIES, "tiny", made)


def test_rows_are_printed_and_kept(tiny, tmp_path, capsys):
    assert main(["run", "tiny", "--quick", "--out", str(tmp_path), "--json", "--quiet"]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["case"] for row in printed] == ["needle", "disc"]
    assert printed[1]["error"] is None
    kept = [json.loads(line) for line in (tmp_path / "tiny.jsonl").read_text().splitlines()]
    assert kept == printed


def test_a_row_over_its_budget_fails_the_command(tiny, tmp_path, capsys):
    assert main(["run", "tiny", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert [line.split() for line in out.splitlines()] == [
        ["case", "error", "ok"], ["needle", "1e-07", "yes"], ["disc", "nan", "NO"],
    ]  # fmt: skip
    assert "over its budget" in err


def test_quick_is_for_studies(tmp_path, capsys):
    assert main(["run", "quick", "--quick", "--out", str(tmp_path)]) == 2
    assert "--quick is for the studies" in capsys.readouterr().err
