"""What users write for a side, and what they are told when it is nothing."""

import dataclasses
import os
import shutil
from pathlib import Path

import pytest

from helpers import case_folders
from splatproof.base.errors import DataError, UsageError
from splatproof.reports.comparing import baselines
from splatproof.reports.comparing.opening import Spec, open_side, parse
from splatproof.reports.store import sync

OLD, NEW = "0123abc" + "0" * 33, "89abcde" + "1" * 33


def result(seed: int, commit: str = NEW, **changed):
    plain = case_folders.result(seed=seed, **changed)
    return dataclasses.replace(plain, environment=plain.environment | {"commit": commit})


@pytest.fixture(scope="module")
def runs(migrated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs and its store, which also holds the results of an older commit."""
    out = tmp_path_factory.mktemp("compared") / "runs"
    for commit, psnr in ((OLD, 24.0), (NEW, 25.0)):
        shutil.rmtree(out / "quick", ignore_errors=True)
        cases = [result(seed, commit, psnr=psnr) for seed in range(2)]
        cases += [result(0, commit, psnr=psnr, variant="affine")] if commit == NEW else []
        folders = [case_folders.write_case(out / case.variant, case) for case in cases]
        if commit == OLD:
            shutil.copy(migrated, out / "mlflow.db")
        assert sync(folders, f"sqlite:///{out}/mlflow.db") == []
    return out


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("runs", Spec(where="runs")),
        ("runs#3dgs@affine", Spec(where="runs", row="3dgs@affine")),
        ("runs@0123abc#3dgs", Spec(where="runs", commit="0123abc", row="3dgs")),
        ("runs@0123abc-dirty", Spec(where="runs", commit="0123abc-dirty")),
        ("runs@home", Spec(where="runs@home")),
        ("http://u:p@host:5000/", Spec(where="http://u:p@host:5000/")),
        ("http://host:5000/@0123abc", Spec(where="http://host:5000/", commit="0123abc")),
        ("sqlite:///a/mlflow.db@0123abc#x", Spec(where="sqlite:///a/mlflow.db", commit="0123abc", row="x")),
    ],
)  # fmt: skip
def test_a_side_is_taken_apart(text: str, spec: Spec):
    assert parse(text) == spec


@pytest.mark.parametrize("text", ["", "#3dgs", "runs#"])
def test_half_a_side_is_refused(text: str):
    with pytest.raises(UsageError, match="expected WHERE"):
        parse(text)


def test_a_folder_of_that_very_name_is_never_taken_apart(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("runs#3dgs@0123abc").mkdir()
    assert parse("runs#3dgs@0123abc") == Spec(where="runs#3dgs@0123abc")


def test_a_folder_gives_its_records_and_pictures(runs: Path):
    side = open_side(str(runs))
    assert [case.name for case in side.cases] == [
        "quick/town/3dgs/ours_250/seed0", "quick/town/3dgs/ours_250/seed1",
        "quick/town/3dgs@affine/ours_250/seed0",
    ]  # fmt: skip
    assert {case.commit for case in side.cases} == {NEW}
    pictures = side.cases[0].pictures
    assert pictures is not None
    assert str(pictures("render", "dji_0001.jpg"))[3:6] == "x89"
    assert pictures("render", "absent.jpg") is None


def test_an_older_commit_is_found_in_the_store(runs: Path):
    side = open_side(f"{runs}@0123")
    assert {case.commit for case in side.cases} == {OLD}
    assert len(side.cases) == 2
    newest = open_side(f"{runs}/mlflow.db")
    assert {case.commit for case in newest.cases} == {NEW}
    assert newest.cases[0].pictures is not None


def test_a_row_is_chosen(runs: Path):
    assert {c.measured.row for c in open_side(f"{runs}#3dgs@affine").cases} == {"3dgs@affine"}


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ("#3dgs@afine", "did you mean '3dgs@affine'"),
        ("@ffff", "unknown 'ffff'. There are: 0123abc000, 89abcde111"),
        ("@0123abc-dirty", "unknown '0123abc-dirty'"),
    ],
)
def test_what_is_not_there_is_told_with_what_is(runs: Path, end: str, message: str):
    with pytest.raises(UsageError, match=message):
        open_side(f"{runs}{end}")


def test_an_unknown_suite_is_refused(runs: Path):
    with pytest.raises(UsageError, match="suite of .*unknown 'quik', did you mean 'quick'"):
        open_side(str(runs), suites=["quik"])


def test_a_commit_that_may_be_several_is_refused(tmp_path: Path):
    for seed, end in ((0, "a"), (1, "b")):
        case_folders.write_case(tmp_path, result(seed, "0123abc" + end * 33))
    with pytest.raises(UsageError, match="may be any of 0123abcaaa, 0123abcbbb"):
        open_side(f"{tmp_path}@0123abc")


def test_a_clean_commit_is_meant_where_both_are_there(tmp_path: Path):
    for seed, commit in ((0, OLD), (1, OLD + "-dirty")):
        case_folders.write_case(tmp_path, result(seed, commit))
    assert [c.measured.seed for c in open_side(f"{tmp_path}@0123abc").cases] == [0]
    assert [c.measured.seed for c in open_side(f"{tmp_path}@0123abc-dirty").cases] == [1]


def test_a_baseline_is_found_by_name_and_by_file(runs: Path, tmp_path: Path):
    path = baselines.path_of("held", tmp_path)
    baselines.write(path, open_side(str(runs)).cases)
    for text in ("held", str(path), "held@89abcde#3dgs"):
        assert open_side(text, folder=tmp_path).cases[0].measured.row == "3dgs"
    with pytest.raises(UsageError, match=r"hold: no folder of runs.*did you mean 'held'"):
        open_side("hold", folder=tmp_path)


def test_an_empty_folder_is_no_side(tmp_path: Path):
    with pytest.raises(DataError, match="no case; run a suite there first"):
        open_side(str(tmp_path))


def test_a_damaged_record_is_told(tmp_path: Path):
    folder = case_folders.write_case(tmp_path, result(0))
    (folder / "record.json").write_text("{")
    with pytest.raises(DataError, match=r"record.json: not a result record"):
        open_side(str(tmp_path))


@pytest.mark.parametrize("last", ["a", "b"])
def test_of_a_case_in_several_folders_the_newest_counts_and_that_is_said(tmp_path: Path, last: str):
    """As in .splatproof, where each state of the code has a folder."""
    for name, psnr in (("a", 20.0), ("b", 25.0)):
        folder = case_folders.write_case(tmp_path / name, result(0, psnr=psnr))
        written = 2e9 if name == last else 1e9
        os.utime(folder / "record.json", (written, written))
    side = open_side(str(tmp_path))
    assert side.cases == open_side(str(tmp_path / last)).cases
    (said,) = side.remarks
    assert "quick/town/3dgs/ours_250/seed0 in several folders; the newest counts" in said
    assert str(tmp_path / last) in said


def test_several_settings_of_one_case_are_remarked(migrated: Path, tmp_path: Path):
    """A store keeps both; a side has one case of a name."""
    shutil.copy(migrated, tmp_path / "mlflow.db")
    for number, steps in enumerate((1000, 2000)):
        case = result(0, settings={"iterations": steps})
        folder = case_folders.write_case(tmp_path / str(number), case)
        assert sync([folder], f"sqlite:///{tmp_path}/mlflow.db") == []
    side = open_side(f"{tmp_path}/mlflow.db")
    assert [case.settings for case in side.cases] == [{"iterations": 2000}]
    assert (
        "of several settings of quick/town/3dgs/ours_250/seed0 the newest counts" in side.remarks[0]
    )
