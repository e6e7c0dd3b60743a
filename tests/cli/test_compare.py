"""`bench compare` and `bench baseline` as a user types them."""

import dataclasses
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from helpers import case_folders
from splatproof.cli import main


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two folders of three seeds: `old`, and `new`, which is 1 dB worse on one of two scenes."""
    out = tmp_path_factory.mktemp("runs")
    for name, town in (("old", 24.0), ("new", 23.0)):
        for scene, psnr in (("town", town), ("beach", 26.0)):
            for seed in range(3):
                case = case_folders.result(scene=scene, seed=seed, psnr=psnr)
                if name == "new":
                    case = dataclasses.replace(
                        case, settings=case.settings | {"sh_degree": 2},
                        model_sha256="0" + case.model_sha256[1:],
                    )  # fmt: skip
                case_folders.write_case(out / name, case)
    return out


def bench(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_a_regression_ends_with_1_and_says_where(runs: Path, capsys):
    code, out, _ = bench(capsys, "compare", runs / "old", runs / "new")
    assert code == 1
    assert out.startswith("REGRESSED: ")
    assert re.search(
        r"worse +quick/town/3dgs/ours_250 +psnr +24\.\d\d dB +23\.\d\d dB +-1\.0\d\d", out
    )
    assert re.search(r"settings +sh_degree +3 +2 +everywhere", out)
    assert "Holm's correction: the chance of any false better or worse is at most 0.05" in out


def test_nothing_worse_ends_with_0(runs: Path, capsys):
    code, out, _ = bench(capsys, "compare", runs / "old", runs / "old")
    assert code == 0
    assert out.startswith("no regression: ")


@pytest.mark.parametrize(
    ("part", "gone"),
    [("quick/beach", "quick/beach/3dgs/ours_250"), ("**/beach/**/seed1", "3dgs/ours_250/seed1")],
)
def test_what_is_gone_is_listed_and_with_complete_ends_with_1(
    runs: Path, tmp_path: Path, capsys, part: str, gone: str
):
    shutil.copytree(runs / "old", tmp_path / "less")
    for folder in (tmp_path / "less").glob(f"**/{part}"):
        shutil.rmtree(folder)
    code, out, _ = bench(capsys, "compare", runs / "old", tmp_path / "less")
    assert code == 0
    assert gone in out
    code, _, err = bench(capsys, "compare", runs / "old", tmp_path / "less", "--complete")
    assert code == 1
    assert "--complete: NEW lacks 1 of BASE's, or cannot be compared there: " in err
    assert gone in err
    code, _, _ = bench(capsys, "compare", tmp_path / "less", runs / "old", "--complete")
    assert code == 0  # what is new is no fault


def test_other_photos_with_complete_end_with_1(runs: Path, tmp_path: Path, capsys):
    shutil.copytree(runs / "old", tmp_path / "other")
    for file in (tmp_path / "other").glob("**/beach/**/record.json"):
        text = json.loads(file.read_text())
        for image in text["images"]:
            image["truth_sha256"] = "0" * 64
        file.write_text(json.dumps(text))
    code, out, _ = bench(capsys, "compare", runs / "old", tmp_path / "other")
    assert (code, "quick/beach" in out) == (0, True)
    code, _, err = bench(capsys, "compare", runs / "old", tmp_path / "other", "--complete")
    assert (code, "quick/beach/3dgs/ours_250" in err) == (1, True)


def test_a_metric_that_is_gone_with_complete_ends_with_1(runs: Path, tmp_path: Path, capsys):
    shutil.copytree(runs / "old", tmp_path / "less")
    for file in (tmp_path / "less").glob("**/town/**/record.json"):
        text = json.loads(file.read_text())
        for image in (text, *text["images"]):
            image["metrics"].pop("psnr")
        file.write_text(json.dumps(text))
    code, _, err = bench(capsys, "compare", runs / "old", tmp_path / "less", "--complete")
    assert (code, "quick/town/3dgs/ours_250 psnr" in err) == (1, True)


def test_json_is_an_object_a_line(runs: Path, capsys):
    code, out, _ = bench(
        capsys, "compare", runs / "old", runs / "new", "--metrics", "psnr", "--json"
    )
    lines = [json.loads(line) for line in out.splitlines()]
    found = {one["scene"]: one for one in lines if one["kind"] == "comparison"}
    assert code == 1
    assert found["town"]["verdict"] == "worse"
    assert found["town"]["difference"] == pytest.approx(-1, abs=0.1)
    low, high = found["town"]["corrected_interval"]
    assert low < found["town"]["interval"][0] < found["town"]["interval"][1] < high < 0
    assert lines[-1]["kind"] == "summary"
    assert lines[-1]["regressed"] is True
    assert lines[-1]["tests"] == 2


def test_a_report_for_a_pull_request_has_its_pictures_beside_it(runs: Path, tmp_path: Path, capsys):
    report = tmp_path / "pr.md"
    bench(capsys, "compare", runs / "old", runs / "new", "--metrics", "psnr", "--markdown", report)
    text = report.read_text()
    assert text.startswith("### REGRESSED: 1 worse")
    assert "| **worse** | quick/town/3dgs/ours\\_250 | psnr |" in text
    assert text.count("<details>") == text.count("</details>") >= 3
    linked = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert len(linked) == 3  # two views of town, and a profile
    for path in linked:
        assert cv2.imread(str(tmp_path / path)) is not None, path
    assert len(list((tmp_path / "pr_pictures").iterdir())) == 3


def test_a_baseline_is_saved_listed_and_compared_with(
    runs: Path, tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, out, _ = bench(capsys, "baseline", "save", "held", runs / "old")
    assert (code, out.startswith("held: quick; 6 cases; commit 0123abc; ")) == (0, True)
    assert bench(capsys, "baseline", "list")[1] == out
    code, out, err = bench(capsys, "compare", "held", runs / "new", "--markdown", "pr.md")
    assert code == 1
    assert "no crops: BASE has no pictures" in err
    code, _, err = bench(capsys, "baseline", "save", "held", runs / "new")
    assert code == 2
    assert "--replace" in err
    assert bench(capsys, "baseline", "save", "held", runs / "new", "--replace")[0] == 0
    assert bench(capsys, "compare", "held", runs / "new")[0] == 0


def test_bands_are_measured_from_seeds(runs: Path, capsys):
    code, out, _ = bench(capsys, "baseline", "bands", runs / "old", "--json")
    found = {one["metric"]: one for one in map(json.loads, out.splitlines())}
    assert code == 0
    assert 0.01 < found["psnr"]["deviation"] < 0.15  # seeds were drawn with 0.05 dB
    assert found["psnr"]["freedom"] == 4
    assert found["psnr"]["declared"] == 0.15
    assert found["disk_mb"]["relative"] is True


def test_own_bands_replace_the_declared_ones(runs: Path, tmp_path: Path, capsys):
    path = tmp_path / "bands.toml"
    path.write_text('[bands.psnr]\nunit = "dB"\nvalue = 5.0\nmeasured = "x"\ncommand = "y"\n')
    sides = runs / "old", runs / "new", "--metrics", "psnr", "--bands", path
    code, out, _ = bench(capsys, "compare", *sides)
    assert code == 0
    assert out.startswith("no regression: 2 equal")
    path.write_text('[bands.psnr]\nunit = "dB"\nvalue = -1.0\nmeasured = "x"\ncommand = "y"\n')
    code, _, err = bench(capsys, "compare", *sides)
    assert code == 2
    assert "value -1.0: expected 0 or more" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["old", "nowhere"], "no folder of runs, no store"),
        (["old", "new", "--alpha", "2"], "--alpha 2: expected a rate between 0 and 1"),
        (["old", "new", "--metrics", "psrn"], "did you mean 'psnr'"),
        (["old", "new", "--suite", "quik"], "did you mean 'quick'"),
    ],
)
def test_wrong_use_is_told_in_a_line(
    runs: Path, arguments: list[str], message: str, monkeypatch, capsys
):
    monkeypatch.chdir(runs)
    code, _, err = bench(capsys, "compare", *arguments)
    assert code == 2
    assert message in err
    assert err.count("\n") == 1


def edited(runs: Path, folder: Path, change: Callable[[dict], object]) -> Path:
    """A copy of the old runs with every record of `town` changed."""
    shutil.copytree(runs / "old", folder)
    for file in folder.glob("**/town/**/record.json"):
        record = json.loads(file.read_text())
        change(record)
        file.write_text(json.dumps(record))
    return folder


def test_a_verdict_without_an_interval_says_why(runs: Path, tmp_path: Path, capsys):
    undefined = {"psnr": "NaN", "ssim_3dgs": 0.5}
    new = edited(runs, tmp_path / "new", lambda r: r["images"][1].update(metrics=undefined))
    code, out, _ = bench(capsys, "compare", runs / "old", new)
    assert code == 1
    assert "worse: quick/town/3dgs/ours_250 psnr: psnr of dji_0009.jpg is undefined on NEW" in out
    for seed in ("seed1", "seed2"):
        for folder in new.glob(f"**/{seed}"):
            shutil.rmtree(folder)
    _, out, _ = bench(capsys, "compare", runs / "new", new, "--metrics", "ssim_3dgs")
    assert "ssim_3dgs: one seed on NEW gives no interval; run at least 3" in out.replace("\n", "")


def test_where_nothing_is_judged_nothing_is_called_no_regression(runs: Path, capsys):
    code, out, err = bench(capsys, "compare", runs / "old", runs / "new", "--metrics", "render_ms")
    assert (code, out.startswith("NOT COMPARED: 2 not judged")) == (2, True)
    assert "no metric of a case in common that can be compared" in err


def test_a_metric_without_a_known_better_side_is_named(runs: Path, tmp_path: Path, capsys):
    def adds(record: dict) -> None:
        record["protocol_rules"]["metrics"] = ["psnr", "worst_tile"]
        for scores in (record, *record["images"]):
            scores["metrics"]["worst_tile"] = 0.5

    new = edited(runs, tmp_path / "new", adds)
    _, out, _ = bench(capsys, "compare", new, new)
    assert "name the file that has it with --plugin, or install its package: worst_tile" in out
    assert "asked for with --metrics: cpu_seconds" in out
    code, out, _ = bench(capsys, "compare", new, new, "--metrics", "primitives")
    assert code == 2
    assert "asked for with --metrics, but has no better side: primitives" in out


def test_sides_without_a_common_case_end_with_2(runs: Path, tmp_path: Path, capsys):
    case_folders.write_case(tmp_path, case_folders.result(scene="elsewhere"))
    code, out, err = bench(capsys, "compare", runs / "old", tmp_path)
    assert code == 2
    assert "NOT COMPARED" in out
    assert "missing on BASE" in out
    assert "no case in common" in err
