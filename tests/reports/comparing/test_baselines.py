"""Frozen results: whole, small, the same bytes again, and refused when damaged."""

import dataclasses
import json
import math
from pathlib import Path

import pytest

from helpers import case_folders
from helpers.compared_sides import drawn_pair
from splatproof.base.errors import DataError, UsageError
from splatproof.reports.comparing import baselines
from splatproof.reports.comparing.cases import case_record
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.sides import side_of


@pytest.fixture
def side():
    """Six cases of real shape: one failed, one with an infinite score."""
    results = [case_folders.result(scene=s, seed=k) for s in ("town", "beach") for k in range(3)]
    results[1] = dataclasses.replace(results[1], error="out of memory", images=(), metrics={})
    first = dataclasses.replace(results[0].images[0], metrics={"psnr": math.inf, "ssim_3dgs": 1.0})
    results[0] = dataclasses.replace(results[0], images=(first, *results[0].images[1:]), curve=())
    return side_of("results", results)


def test_what_is_read_is_what_was_written(side, tmp_path: Path):
    path = tmp_path / "b.json"
    baselines.write(path, side.cases)
    assert baselines.read(path, "again").cases == side.cases
    assert math.isinf(side.cases[0].measured.late_gain) or side.cases[3].measured.late_gain > 0


def test_settings_without_an_end_are_kept(tmp_path: Path):
    """JSON has no such number."""
    settings = {"limit": math.inf, "deep": {"ends": (-math.inf, 1.0)}}
    side = side_of("results", [case_folders.result(settings=settings)])
    baselines.write(tmp_path / "b.json", side.cases)
    again = baselines.read(tmp_path / "b.json", "again")
    assert again.cases == side.cases
    assert not compare(again, side).differing


def test_a_baseline_compares_as_its_results_do(side, tmp_path: Path):
    baselines.write(tmp_path / "b.json", side.cases)
    found = compare(baselines.read(tmp_path / "b.json", "b"), side)
    assert found.counts["equal"] > 0
    assert set(found.counts) <= {"equal", "not judged"}
    assert {one.measure.metric for one in found.compared if one.verdict == "not judged"} <= {
        "train_seconds", "render_ms", "peak_memory_mb",
    }  # fmt: skip
    assert not found.differing


def test_the_same_results_give_the_same_small_file(side, tmp_path: Path):
    for name, cases in (("a", side.cases), ("b", side.cases[::-1])):
        baselines.write(tmp_path / name, cases)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (tmp_path / "a").stat().st_size < 10_000


def test_a_new_score_changes_only_its_case_and_the_checksum(side, tmp_path: Path):
    """So a pull request shows which cases moved."""
    baselines.write(tmp_path / "a", side.cases)
    moved = dataclasses.replace(side.cases[0], model="other")
    baselines.write(tmp_path / "b", (moved, *side.cases[1:]))
    lines = [(tmp_path / name).read_text().splitlines() for name in ("a", "b")]
    assert sum(one != other for one, other in zip(*lines, strict=True)) == 2


def edited(text: str, before: str, after: str) -> str:
    assert before in text
    return text.replace(before, after, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: len(text) // 2], "not JSON"),
        (lambda text: edited(text, '"seed":2', '"seed":7'), "edited or badly merged"),
        (lambda text: edited(text, '"seed":2', '"seed":1e999'), "a number that is not finite"),
        (
            lambda text: edited(text, '"version": 1', '"version": 9'),
            "version 9, this release reads 1",
        ),
        (lambda text: "{}", "no baseline; expected a file that `bench baseline save` wrote"),
        (lambda text: "[]", "no baseline"),
    ],
)
def test_a_damaged_file_is_refused_with_what_to_do(side, tmp_path: Path, change, message: str):
    path = tmp_path / "b.json"
    baselines.write(path, side.cases)
    path.write_text(change(path.read_text()))
    with pytest.raises(DataError, match=message) as told:
        baselines.read(path, "b")
    assert str(path) in str(told.value)


@pytest.mark.parametrize("damage", [{"cases": [{}]}, {"cases": 3}, {"cases": [{"measured": 1}]}])
def test_a_file_with_a_fitting_checksum_and_no_cases_is_refused(tmp_path: Path, damage):
    """Another program may have written it."""
    path = tmp_path / "b.json"
    body = {name: [] for name in baselines.SHARED} | damage
    head = {"format": baselines.FORMAT, "version": 1, "sha256": baselines.checksum(body)}
    path.write_text(json.dumps(head | body))
    with pytest.raises(DataError, match="damaged"):
        baselines.read(path, "b")


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden"])
def test_a_name_is_a_plain_one(name: str):
    with pytest.raises(UsageError, match="plain name"):
        baselines.path_of(name)


def test_records_are_rounded_alike_on_both_sides():
    one = case_folders.result()
    record = case_record(one)
    assert record.measured.images["dji_0001.jpg"]["psnr"] == float(
        f"{one.images[0].metrics['psnr']:.6g}"
    )
    assert compare(*drawn_pair(0), bands={}).compared
