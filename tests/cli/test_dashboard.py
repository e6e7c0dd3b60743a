"""`bench dashboard`: what it writes, and how it refuses."""

import json
import shutil
from pathlib import Path

import pytest

from helpers import case_folders
from helpers.empty_store import lay_empty_store
from helpers.generated_store import write_store
from splatproof.cli import main


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    lay_empty_store(folder)
    write_store(folder, [case_folders.result(seed=0)])
    return folder


def test_a_static_page_is_written_and_told(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    page = tmp_path / "page"
    assert main(["dashboard", "--out", str(out), "--static", str(page), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["page"] == str(page / "index.html")
    assert told["files"] == sum(path.is_file() for path in page.rglob("*"))
    assert "splatproof.take" in (page / "data" / "index.js").read_text("utf-8")
    assert (out / "mlflow.dashboard").exists()
    shutil.rmtree(page)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "nowhere"], "nothing to show"),
        (["--uri", "runs"], "tracking URI"),
        (["--picture-mb", "-1"], "--picture-mb"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert main(["dashboard", *arguments]) == 2
    assert said in capsys.readouterr().err
