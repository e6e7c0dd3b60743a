"""The page of suite minute: made of the committed rows, its table and its duel by hand."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from make_minute_page import Row, at, duel, first_at, page, parts_of_time, planned, table

DOCS = Path(__file__).parents[2] / "docs"


def row(name: str, seed: int, values: dict[float, float], total: float = 60.0) -> Row:
    timed = tuple((t, {"psnr": v, "ssim_3dgs": v / 100, "flip": 0.1}) for t, v in values.items())
    return Row(
        scene="yard", protocol="p", row=name, seed=seed, timed=timed, final=timed[-1][1],
        primitives=1000, stages={"load": 1.0, "init": 2.0, "train": 57.0}, total=total, machine="m",
        plan={"steps": "5 (because)"} if name == "auto" else {},
    )  # fmt: skip


AUTO = [
    row("auto", seed, {10.0: 20.0 + seed, 30.0: 24.0 + seed, 60.0: 25.0 + seed}) for seed in (0, 1)
]
HAND = [
    row("3dgs@hand", seed, {10.0: 18.0, 30.0: 21.0, 60.0: 22.0 + seed}, 80.0) for seed in (0, 1)
]


def test_the_committed_page_is_what_the_generator_makes_of_the_committed_rows():
    assert (DOCS / "minute.md").read_text(encoding="utf-8") == page(DOCS)


def test_scores_at_marks_and_when_a_value_is_reached():
    assert at(AUTO[0], "psnr", 29.0) == 24.0
    assert first_at(AUTO[0], 22.0) == pytest.approx(20.0)
    assert first_at(AUTO[0], 19.0) == 10.0
    assert math.isinf(first_at(AUTO[0], 30.0))


def test_a_line_a_row():
    lines = table([*AUTO, *HAND]).splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("| auto | 2 | 20.50 ±")
    assert "| 80 ± 0 |" in lines[3]
    assert "| 3.0 ± 0.0 |" in lines[3], "opening and initialising"


def test_where_the_seconds_went_is_told_of_rows_that_counted_them():
    read = {"decode": 4.0, "undistort": 2.0, "resize": 1.0}
    assert parts_of_time([*AUTO, *HAND]) == ""
    lines = parts_of_time([*AUTO, *(replace(one, reading=read) for one in HAND)]).splitlines()
    told = [1.0, 0.0, 2.0, 57.0, 4.0, 2.0, 1.0]
    assert lines[-1] == "| 3dgs@hand | 2 | " + " | ".join(f"{one:.1f} ± 0.0" for one in told) + " |"
    assert not any("auto" in line for line in lines)


def test_auto_is_paired_with_the_same_seed():
    text = duel([*AUTO, *HAND])
    assert "+3.00 dB [+3.00, +3.00] after 60 s" in text
    reached = [20.0 / 80.0, (10 + 2 / 4 * 20) / 80.0]
    assert f"in {sum(reached) / 2:.2f}" in text
    assert duel(AUTO) == ""
    assert "- steps: 5 (because)" in planned([*HAND, *AUTO])
