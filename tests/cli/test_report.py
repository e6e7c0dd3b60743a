"""`bench report` as a user calls it."""

import json
import shutil
from pathlib import Path

import pytest

from helpers import case_folders
from helpers.empty_store import lay_empty_store
from splatproof.cli import main


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished cases, and a store that does not know them yet."""
    out = tmp_path_factory.mktemp("runs")
    lay_empty_store(out)
    for seed in range(3):
        case_folders.write_case(out, case_folders.result(seed=seed))
    return out


@pytest.fixture(autouse=True)
def _no_store_of_the_user(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


def test_it_logs_what_is_new_prints_the_table_and_says_where_the_page_is(runs: Path, capsys):
    assert main(["report", "--out", str(runs), "--markdown", str(runs / "board.md")]) == 0
    shown = capsys.readouterr()
    page = runs / "report.html"
    assert f"page: {page}" in shown.out
    assert "quick · town · ours_250" in shown.out
    assert "±" in shown.out
    assert shown.err == ""
    assert "<!doctype html>" in page.read_text("utf-8")
    assert (runs / "board.md").read_text("utf-8").startswith("# Leaderboard")
    assert not list(runs.glob("*.partial"))


def test_json_gives_a_case_a_line_from_the_store_alone(runs: Path, capsys, tmp_path: Path):
    assert main(["report", "--out", str(runs)]) == 0
    capsys.readouterr()
    uri = f"sqlite:///{runs}/mlflow.db"
    page = tmp_path / "page.html"
    code = main(
        ["report", "--out", str(tmp_path / "no"), "--uri", uri, "--html", str(page), "--json"]
    )
    assert code == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["seed"] for line in lines] == [0, 1, 2]
    assert {line["scene"] for line in lines} == {"town"}
    assert lines[1]["psnr"] == case_folders.result(seed=1).metrics["psnr"]
    assert page.exists()
    assert not (tmp_path / "no").exists()


def test_nothing_to_report_is_a_usage_error_and_leaves_nothing(tmp_path: Path, capsys):
    assert main(["report", "--out", str(tmp_path / "empty")]) == 2
    err = capsys.readouterr().err
    assert "nothing to report" in err
    assert "bench run quick" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_case_is_told_and_the_rest_is_reported(runs: Path, tmp_path: Path, capsys):
    out = tmp_path / "runs"
    shutil.copytree(runs / "quick", out / "quick")
    lay_empty_store(out)
    damaged = min(out.rglob("record.json"))
    damaged.write_text("{")
    assert main(["report", "--out", str(out), "--json"]) == 1
    shown = capsys.readouterr()
    assert len(shown.out.splitlines()) == 2
    assert f"{damaged}: not a result record" in shown.err


def test_a_store_that_is_away_is_told_once_and_the_exit_code_is_3(
    runs: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    assert main(["report", "--out", str(runs), "--uri", "http://127.0.0.1:9"]) == 3
    err = capsys.readouterr().err
    assert "and 2 more: not logged: tracking store http://127.0.0.1:9 does not answer" in err
    assert err.count("\n") == 2
    assert "Traceback" not in err


def test_a_store_that_mlflow_refuses_is_a_usage_error(runs: Path, capsys):
    assert main(["report", "--out", str(runs), "--uri", "file:///tmp/mlruns"]) == 2
    assert "sqlite:///" in capsys.readouterr().err
