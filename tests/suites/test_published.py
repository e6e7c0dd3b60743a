"""Published numbers: whole, spelled as printed, and bound to scenes that the suites have."""

import json
import statistics

import pytest

from helpers.case_folders import result
from splatproof.base.errors import UsageError
from splatproof.cli import main
from splatproof.datasets.catalogue.registry import get_entry
from splatproof.suites.published import ours, rows
from splatproof.suites.records import write_record
from splatproof.suites.suite_files import load_suite

KEY = ("paper", "table", "method", "variant", "dataset", "scene", "metric")


def value(**place: str) -> float:
    """The one printed value at a place."""
    found = [line for line in rows.numbers() if all(line[k] == v for k, v in place.items())]
    assert len(found) == 1, place
    return float(found[0]["value"])


def test_every_number_is_there_once():
    numbers = rows.numbers()
    assert len(numbers) == 2078
    assert len({tuple(line[key] for key in KEY) for line in numbers}) == len(numbers)
    for line in numbers:
        float(line["value"])
        assert line["higher_is_better"] in ("true", "false", "")


def test_numbers_read_in_the_papers():
    rubble = {"paper": "StitchGS", "table": "3", "method": "3DGS", "scene": "Rubble"}
    assert [value(**rubble, metric=m) for m in ("psnr", "ssim", "lpips")] == [25.24, 0.755, 0.253]
    dpgs = {"paper": "DPGS", "table": "1", "method": "Mega-NeRF", "scene": "Sci-Art"}
    assert value(**dpgs, metric="psnr") == 23.12
    best = {"paper": "StratoSplat", "table": "1", "method": "StratoSplat", "scene": ""}
    assert value(**best, metric="psnr") == 24.48


@pytest.mark.parametrize("suite", rows.published_suites())
def test_scenes_of_a_paper_are_those_of_its_suite(suite):
    paper = rows.load_published(suite)
    assert set(paper.scenes) == set(load_suite(suite).scenes)
    for scene in paper.scenes:
        assert get_entry(scene).kind == "public"
        found = rows.rows_of(paper, scene)
        why = rows.reasons(paper, scene)
        assert any("psnr" in row.values for row in found) or any("none can be" in w for w in why)
        assert why  # no paper states everything: none is comparable yet
    assert paper.contradictions


def test_contradictions_follow_from_the_numbers():
    table = {"paper": "StratoSplat", "table": "1", "method": "DepthSplat", "metric": "psnr"}
    scenes = [
        float(line["value"])
        for line in rows.numbers()
        if line["scene"] and all(line[k] == v for k, v in table.items())
    ]
    assert len(scenes) == 16
    assert f"{statistics.fmean(scenes):.2f}" == "15.63"
    assert value(**table, scene="") == 15.75
    first = {"paper": "StratoSplat", "table": "2", "scene": "City Scene 0", "metric": "psnr"}
    assert value(**first, method="StratoSplat") == 28.21
    again = [
        line["value"]
        for line in rows.numbers()
        if (line["table"], line["metric"]) == ("5", "psnr") and line["paper"] == "StratoSplat"
    ]
    assert sorted(again) == ["22.99", "23.21"]
    sizes = {"paper": "StitchGS", "method": "StitchGS", "variant": "", "scene": "Aerial"}
    points = value(**sizes, table="6", metric="points_millions") * 1e6
    assert value(**sizes, table="6", metric="storage_mb") * 2**20 / points == pytest.approx(
        79, abs=0.3
    )


def test_suspect_values_are_marked():
    place = rows.Place(dataset="3DAS", scene="City Scene 0", tables=("2",))
    paper = rows.Published(paper="StratoSplat", title="", scenes={"x": place}, differs=())
    marked = {row.method for row in rows.rows_of(paper, "x") if row.suspect}
    assert "StratoSplat" in marked
    assert "3DGS" not in marked
    assert rows.reasons(paper, "x") == ()


def test_unknown_names_are_told():
    with pytest.raises(UsageError, match="paper_dpgs"):
        rows.load_published("paper_dpg")
    with pytest.raises(UsageError, match="no published row belongs to 'mars'"):
        rows.rows_of(rows.load_published("paper_dpgs"), "mars")
    assert main(["published", "paper_dpg"]) == 2


def test_ours_stand_beside_theirs(tmp_path, capsys):
    for seed in (0, 1):
        record = result(suite="paper_dpgs", scene="mill19/rubble", seed=seed)
        folder = tmp_path / f"paper_dpgs/mill19/rubble/3dgs/p/seed{seed}"
        folder.mkdir(parents=True)
        write_record(folder, record)
    (row,) = ours.our_rows(tmp_path / "paper_dpgs")
    assert (row.method, row.seeds) == ("3dgs", 2)
    command = ["published", "paper_dpgs", "--scene", "mill19/rubble", "--out", str(tmp_path)]
    assert main([*command, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [r["method"] for r in records if r["ours"]] == ["3dgs"]
    assert len([r for r in records if not r["ours"]]) == 6
    assert not any(r["comparable"] for r in records)
    assert main(command) == 0
    text = capsys.readouterr().out
    for part in (
        "DOGS",
        "0.707",
        "DPGS, table 1",
        "2 seeds",
        "ours are not comparable: ",
        "cannot be",
    ):
        assert part in text
    assert main(["published", "paper_dpgs", "--scene", "mill19/ruble"]) == 2
    assert "did you mean 'mill19/rubble'" in capsys.readouterr().err
    assert main(["published", "--scene", "mill19/rubble"]) == 2
    assert "name its suite too" in capsys.readouterr().err
    assert main(["published"]) == 0
    assert "paper_stitchgs: StitchGS" in capsys.readouterr().out


def test_a_paper_suite_plans_and_refuses(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["run", "paper_dpgs", "--dry-run", "--only", "*/3dgs/*", "--json"]) == 0
    out, err = capsys.readouterr()
    records = [json.loads(line) for line in out.splitlines()]
    assert {r["scene"] for r in records} == set(rows.load_published("paper_dpgs").scenes)
    assert all("To get it" in r["missing"] and r["estimated_seconds"] is None for r in records)
    assert err.count("not here: ") == 4
    assert main(["run", "paper_dpgs"]) == 3
    err = capsys.readouterr().err
    assert err.startswith("bench: mill19/rubble: not on this machine; looked for ")
    assert len(err.strip().splitlines()) == 1
