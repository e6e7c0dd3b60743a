"""Counters of two sides: the very same, changed, more work, or not to be compared."""

import dataclasses

import pytest

from helpers.case_folders import result
from splatproof.reports.comparing import wording
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.counters import SAME_BITS, WORK, Counted
from splatproof.reports.comparing.markdown import markdown
from splatproof.reports.comparing.sides import side_of
from splatproof.reports.comparing.terminal import records

HERE = {"simd": "avx2", "backend": "cpu", "torch": "2.13.0", "numpy": "2.1"}
COUNTERS = {"pairs": 1_000_000, "resets": 3}


def side(label: str, seeds=(0, 1), *, environment=HERE, **counters: int):
    """Cases of a row with the same counters in each seed."""
    return side_of(
        label,
        [
            result(seed=seed, counters=COUNTERS | counters, environment=dict(environment))
            for seed in seeds
        ],
    )


def counters(base, new) -> dict[str, Counted]:
    return {one.counter: one for one in compare(base, new).counters}


def test_the_very_same_numbers_are_the_same_whatever_computed_them():
    for environment in (HERE, HERE | {"simd": "avx512"}):
        found = counters(side("BASE"), side("NEW", environment=environment))
        assert {name: one.verdict for name, one in found.items()} == {
            "pairs": "same", "resets": "same",
        }  # fmt: skip
        assert (found["pairs"].base, found["pairs"].new) == (2_000_000, 2_000_000)


def test_another_number_is_a_change_and_from_where_to_where_is_told():
    found = counters(side("BASE"), side("NEW", resets=4))["resets"]
    assert (found.verdict, found.base, found.new) == ("changed", 6, 8)
    fewer = counters(side("BASE"), side("NEW", resets=2))["resets"]
    assert (fewer.verdict, fewer.new) == ("changed", 4)


def test_seeds_that_make_up_for_one_another_are_still_a_change():
    both = [result(seed=seed, counters=COUNTERS, environment=HERE) for seed in (0, 1)]
    moved = [
        dataclasses.replace(one, counters=COUNTERS | {"pairs": pairs})
        for one, pairs in zip(both, (1_000_001, 999_999), strict=True)
    ]
    found = counters(side_of("BASE", both), side_of("NEW", moved))["pairs"]
    assert (found.verdict, found.base, found.new) == ("changed", 2_000_000, 2_000_000)


def test_more_work_than_the_band_is_a_regression_and_less_is_none():
    most = round(1_000_000 * (1 + WORK["pairs"]))
    within = compare(side("BASE"), side("NEW", pairs=most))
    assert not within.regressions
    beyond = compare(side("BASE"), side("NEW", pairs=most + 1))
    assert beyond.regressions == ("quick/town/3dgs/ours_250 pairs",)
    assert counters(side("BASE"), side("NEW", pairs=most + 1))["pairs"].verdict == "worse"
    assert not compare(side("BASE"), side("NEW", pairs=1)).regressions


@pytest.mark.parametrize("part", SAME_BITS)
def test_what_was_computed_differently_is_not_compared(part):
    other = side("NEW", environment=HERE | {part: "another"}, pairs=10**9)
    found = compare(side("BASE"), other)
    assert not found.regressions
    (pairs,) = [one for one in found.counters if one.counter == "pairs"]
    assert pairs.verdict == "not compared"
    assert pairs.reason == f"computed with other {part}: {HERE[part]} and another"


def test_other_seeds_are_not_compared():
    found = counters(side("BASE"), side("NEW", seeds=(2, 3)))["pairs"]
    assert (found.verdict, found.reason) == ("not compared", "no seed is on both sides")


def test_a_counter_that_a_case_lacks_is_left_out():
    older = side_of("BASE", [result(seed=seed, environment=HERE) for seed in (0, 1)])
    assert not compare(older, side("NEW")).counters


def test_people_and_machines_are_told_what_changed_and_worse_work_first():
    found = compare(side("BASE"), side("NEW", pairs=2_000_000, resets=4))
    assert "REGRESSED" in wording.verdict_line(found)
    assert "more work: pairs" in wording.verdict_line(found)
    rows = [wording.counter_texts(one) for one in wording.counters_shown(found)]
    case = "quick/town/3dgs/ours_250"
    assert rows == [
        ["worse", case, "pairs", "2,000,000", "4,000,000", "+100.00 %", "more than 10% more work"],
        ["changed", case, "resets", "6", "8", "+33.33 %", "other numbers in the same seeds"],
    ]
    assert "| **worse** | quick/town/3dgs/ours\\_250 | pairs |" in markdown(found, [], [])
    told = [record for record in records(found, []) if record["kind"] == "counter"]
    assert told[0] == {
        "kind": "counter", "case": case, "counter": "pairs", "verdict": "worse", "base": 2_000_000,
        "new": 4_000_000, "reason": "more than 10% more work",
    }  # fmt: skip


def test_the_same_counters_are_one_remark():
    found = compare(side("BASE"), side("NEW"))
    assert not wording.counters_shown(found)
    assert "counters that are the same in every seed: 2 of 2" in wording.remarks(found)
    changed = compare(side("BASE"), side("NEW", resets=4))
    assert "<details><summary>Counters (1 differ)</summary>" in markdown(changed, [], [])
