"""The guides, followed to the letter: one folder, every file, every command."""

import json
from pathlib import Path

import pytest
import torch

import splatproof as sp
from helpers.guides import commands, follow
from splatproof.base import plugin_files
from splatproof.base.files import sha256
from splatproof.base.plugin_files import plugin_files as loaded
from splatproof.cli import main
from splatproof.datasets.photos import read_photo
from splatproof.metrics.registry import find_metric

PAGES = ("scene", "method", "metric", "suite")


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory):
    """The folder after all guides, their suite only planned, and its plug-ins loaded."""
    folder = tmp_path_factory.mktemp("guides")
    before = dict(plugin_files._loaded)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        for page in PAGES:
            follow(f"guides/{page}.md", folder, patch, only="--dry-run")
    yield folder
    plugin_files._loaded.clear()
    plugin_files._loaded.update(before)


def test_the_record_names_the_files_and_their_hashes(followed: Path):
    facts = json.loads((followed / "still" / "record.json").read_text())["scene_facts"]
    assert facts["plugin still_splats.py"] == sha256(followed / "still_splats.py")
    assert facts["plugin rig.py"] == sha256(followed / "rig.py")
    assert "plugin worst_tile.py" not in facts  # its protocol is another one


def test_a_changed_file_is_told_and_what_it_made_is_kept(followed: Path, capsys, monkeypatch):
    monkeypatch.chdir(followed)
    before = (followed / "still" / "record.json").read_bytes()
    source = (followed / "still_splats.py").read_text()
    (fit, again) = [line for line in commands("guides/method.md") if line.startswith("bench fit")]
    try:
        (followed / "still_splats.py").write_text(source.replace("degree=0", "degree=1"))
        assert main(again.partition("#")[0].split()[1:]) == 2
        assert "plugin still_splats.py changed since this was trained" in capsys.readouterr().err
    finally:
        (followed / "still_splats.py").write_text(source)
    assert main([*fit.split()[1:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["status"] == "kept"
    assert (followed / "still" / "record.json").read_bytes() == before


def test_the_method_learns_and_its_number_stays(followed: Path):
    frame = sp.results_frame(followed / "still")
    assert len(frame) == 3
    assert frame["primitives"].unique().tolist() == [40]
    truth = [read_photo(path) for path in sorted((followed / "still" / "truth").iterdir())]
    black = [sp.metrics.psnr(torch.zeros_like(image), image) for image in truth]
    scores = frame["psnr"].tolist()
    assert sum(scores) / 3 > sum(black) / len(black) + 4


def test_the_metric_is_scored_as_by_hand(followed: Path, capsys, monkeypatch):
    monkeypatch.chdir(followed)
    (score,) = [line for line in commands("guides/metric.md") if line.startswith("bench score")]
    capsys.readouterr()
    assert main([*score.split()[1:], "--json", "--quiet"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    first = lines[0]["image"]
    pair = [read_photo(followed / "still" / part / first) for part in ("renders", "truth")]
    error = (pair[0] - pair[1]).abs().mean(dim=2).double()
    tiles = error.reshape(6, 8, 8, 8).mean(dim=(1, 3))
    assert lines[0]["worst_tile"] == pytest.approx(float(tiles.max()), abs=1e-6)
    assert find_metric("worst_tile").function is not None


def test_a_model_renders_its_views_again_with_the_plug_in(followed: Path, tmp_path, monkeypatch):
    monkeypatch.chdir(followed)
    assert main(["render", "still", str(tmp_path / "again"), "--plugin=rig.py", "--quiet"]) == 0
    for path in (followed / "still" / "renders").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_its_settings_are_flags_and_the_option_is_in_the_help(followed: Path, capsys, monkeypatch):
    monkeypatch.chdir(followed)
    assert main(["fit", "--plugin", "still_splats.py", "still-splats", "--help"]) == 0
    text = capsys.readouterr().out
    assert "--opacity" in text
    assert "Opacity that every Gaussian starts with." in text
    assert "--plugin" in text


@pytest.mark.slow  # three fits and a report
def test_the_suite_runs_with_the_plug_ins(followed: Path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    follow("guides/suite.md", followed, monkeypatch)
    frame = sp.results_frame(followed / "runs")
    assert set(frame["row"]) == {"still-splats", "still-splats@faint", "3dgs"}
    assert all(0 < value < 1 for value in frame["worst_tile"].tolist())
    assert (followed / "runs" / "report.html").is_file()
    facts = frame["facts.plugin worst_tile.py"].unique().tolist()
    assert facts == [next(file.sha256 for file in loaded() if file.name == "worst_tile.py")]
