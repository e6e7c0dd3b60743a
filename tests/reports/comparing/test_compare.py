"""Verdicts by hand, what cannot be compared, and properties that hold for any two sides."""

import dataclasses
import math
import time

import numpy as np
import pytest

from helpers.compared_sides import METRICS, RULES, band, case, drawn_pair
from splatproof.base.errors import DataError, UsageError
from splatproof.reports.comparing.compare import Comparison, compare
from splatproof.reports.comparing.sides import Side

BANDS = {"psnr": band(0.05), "ssim_3dgs": band(0.0005, "")}
OPPOSITE = {"better": "worse", "worse": "better"}


def changed(side: Side, number: int, **fields) -> Side:
    """The side with one of its cases changed."""
    cases = list(side.cases)
    cases[number] = dataclasses.replace(cases[number], **fields)
    return dataclasses.replace(side, cases=tuple(cases))


def verdicts(found: Comparison) -> dict[tuple[str, str], str]:
    return {(one.group.scene, one.measure.metric): one.verdict for one in found.compared}


@pytest.mark.parametrize(
    ("effect", "seeds", "expected"),
    [(1.0, 3, "better"), (-1.0, 3, "worse"), (0.15, 3, "undecided"), (0.0, 40, "equal")],
)
def test_a_difference_is_called_by_its_interval(effect: float, seeds: int, expected: str):
    found = compare(*drawn_pair(1, effect, seeds=seeds, interaction=0.005), bands=BANDS)
    for one in found.compared:
        if one.measure.metric == "psnr":
            assert one.verdict == expected, one
            assert one.estimate is not None
            assert one.estimate.mean == pytest.approx(effect, abs=0.12)
    assert bool(found.regressions) == (expected == "worse")


def test_a_certain_difference_within_the_band_is_not_called():
    sides = drawn_pair(1, 0.1, seeds=40, interaction=0.001)
    assert verdicts(compare(*sides, metrics=["psnr"], bands={}))["scene_0", "psnr"] == "better"
    found = compare(*sides, metrics=["psnr"], bands={"psnr": band(0.11)})
    assert verdicts(found)["scene_0", "psnr"] == "undecided"
    assert "within the noise band" in found.compared[0].reason
    wide = compare(*sides, metrics=["psnr"], bands={"psnr": band(0.3)})
    assert verdicts(wide)["scene_0", "psnr"] == "equal"


def test_the_same_side_twice_is_identical_and_no_test():
    base, _ = drawn_pair(0)
    found = compare(base, base, bands=BANDS)
    assert set(verdicts(found).values()) == {"equal"}
    assert found.tests == 0
    assert not found.regressions
    assert not found.differing
    assert {one.reason for one in found.compared} == {"identical: the same models and scores"}


def test_the_same_scores_of_other_models_are_not_identical():
    base, _ = drawn_pair(0)
    other = dataclasses.replace(
        base, cases=tuple(dataclasses.replace(c, model=c.model + "x") for c in base.cases)
    )
    assert compare(base, other, bands=BANDS).tests == len(METRICS) * 2


def test_one_seed_gives_no_verdict_but_says_so():
    found = compare(*drawn_pair(0, 1.0, seeds=1), bands=BANDS)
    assert set(verdicts(found).values()) == {"undecided"}
    assert "one seed on BASE" in found.compared[0].reason
    assert found.tests == 0


def test_one_seed_of_the_same_model_is_identical_all_the_same():
    base, _ = drawn_pair(0, seeds=1)
    assert set(verdicts(compare(base, base, bands=BANDS)).values()) == {"equal"}


def test_a_case_that_newly_fails_is_a_regression():
    base, new = drawn_pair(0)
    run = dataclasses.replace(new.cases[2].measured, error="out of memory", images={}, values={})
    found = compare(base, changed(new, 2, measured=run), bands=BANDS)
    assert found.regressions == ("s/scene_0/3dgs/p/seed2 fails",)
    assert [(one.on, one.error) for one in found.failures] == [("NEW", "out of memory")]
    back = compare(changed(new, 2, measured=run), base, bands=BANDS)
    assert not back.regressions
    assert [one.on for one in back.failures] == ["BASE"]


def test_missing_cases_are_said_by_name():
    base, new = drawn_pair(0)
    found = compare(base, dataclasses.replace(new, cases=new.cases[1:3]), bands=BANDS)
    said = {one.what: one.why for one in found.not_comparable}
    assert said == {
        "s/scene_0/3dgs/p/seed0": "missing on NEW",
        "s/scene_1/3dgs/p": "missing on NEW",
    }
    assert {one.group.scene for one in found.compared} == {"scene_0"}


def test_what_new_alone_has_and_fails_is_told_with_its_error():
    base, new = drawn_pair(0)
    failed = [
        dataclasses.replace(
            one, measured=dataclasses.replace(one.measured, error="no memory", images={}, values={})
        )
        for one in new.cases
    ]
    new = dataclasses.replace(new, cases=(new.cases[0], failed[1], *new.cases[2:-1], failed[-1]))
    base = dataclasses.replace(base, cases=(base.cases[0], *base.cases[2:-1]))
    said = {one.what: one.why for one in compare(base, new, bands=BANDS).not_comparable}
    assert said == {
        f"s/{where}": "missing on BASE; fails: no memory"
        for where in ("scene_0/3dgs/p/seed1", "scene_1/3dgs/p/seed2")
    }


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"truth": {f"view_{i}": "other" for i in range(8)}}, "other truth pixels in 8 of 8"),
        ({"split": "other"}, "other training or test views"),
        ({"rules": RULES | {"rounding": "float"}}, "rounding 'round', 'float'"),
        ({"truth": {"view_0": "sha of view_0"}}, "other scored images"),
    ],
)
def test_what_was_scored_otherwise_is_not_compared(fields, why):
    base, new = drawn_pair(0)
    found = compare(base, changed(new, 0, **fields), bands=BANDS)
    assert {one.group.scene for one in found.compared} == {"scene_1"}
    (fault,) = found.not_comparable
    assert fault.what == "s/scene_0/3dgs/p"
    assert why in fault.why


def test_a_rule_that_adds_scores_keeps_the_others_comparable():
    base, new = drawn_pair(0)
    more = RULES | {"metrics": ["psnr", "lpips_vgg_m11"], "parts": ["moving"]}
    cases = tuple(dataclasses.replace(c, rules=more) for c in new.cases)
    found = compare(base, dataclasses.replace(new, cases=cases), bands=BANDS)
    assert not found.not_comparable
    assert {one.name for one in found.differing if one.kind == "protocol"} == {"metrics", "parts"}


def test_records_from_before_there_was_a_rule_compare_with_those_that_have_it_as_usual():
    base, new = drawn_pair(0)

    def ruled(**rules):
        cases = tuple(dataclasses.replace(c, rules=c.rules | rules) for c in new.cases)
        return compare(base, dataclasses.replace(new, cases=cases), bands=BANDS)

    assert not ruled(region="full").not_comparable
    assert ruled(region="right_half").not_comparable


def test_a_metric_of_one_side_is_said_by_name():
    base, new = drawn_pair(0)
    scores = {"psnr": np.arange(8.0)}
    few = Side(label="new", cases=tuple(case("scene_0", s, scores) for s in range(3)))
    found = compare(base, few, bands=BANDS)
    assert {one.measure.metric for one in found.compared} == {"psnr"}
    said = {one.what for one in found.not_comparable}
    assert {f"s/scene_0/3dgs/p {name}" for name in METRICS[1:]} < said
    assert new.cases


@pytest.mark.parametrize(
    ("odd", "on", "verdict", "why"),
    [
        ("nan", "new", "worse", "undefined on NEW"), ("nan", "base", "undecided", "undefined on BASE"),
        ("inf", "new", "undecided", "infinite on NEW"), ("inf", "base", "undecided", "infinite on BASE"),
    ],
)  # fmt: skip
def test_a_score_that_is_no_number_is_said(odd: str, on: str, verdict: str, why: str):
    sides: dict[str, Side] = dict(zip(("base", "new"), drawn_pair(0), strict=True))
    one = sides[on].cases[0]
    images = {k: dict(v) for k, v in one.measured.images.items()}
    del images["view_3"]["psnr"]
    sides[on] = changed(
        sides[on], 0, not_finite={"view_3": {"psnr": odd}},
        measured=dataclasses.replace(one.measured, images=images),
    )  # fmt: skip
    found = compare(sides["base"], sides["new"], bands=BANDS)
    (psnr,) = [
        o for o in found.compared if (o.group.scene, o.measure.metric) == ("scene_0", "psnr")
    ]
    assert psnr.verdict == verdict
    assert f"psnr of view_3 is {why}" in psnr.reason
    assert bool(found.regressions) == (verdict == "worse")


@pytest.mark.parametrize("odd", ["inf", "nan"])
def test_an_image_without_a_number_on_either_side_is_left_out(odd: str):
    def without(side: Side) -> Side:
        cases = []
        for one in side.cases:
            images = {k: dict(v) for k, v in one.measured.images.items()}
            del images["view_3"]["psnr"]
            run = dataclasses.replace(one.measured, images=images)
            cases.append(
                dataclasses.replace(one, measured=run, not_finite={"view_3": {"psnr": odd}})
            )
        return dataclasses.replace(side, cases=tuple(cases))

    base, new = map(without, drawn_pair(0))
    counts = {o.measure.metric: o.images for o in compare(base, new, bands=BANDS).compared}
    assert (counts["psnr"], counts["flip"]) == (7, 8)


def test_renders_that_equal_the_truth_everywhere_are_equal():
    odd = {f"view_{i}": {"psnr": "inf"} for i in range(8)}
    cases = tuple(case("scene_0", seed, {"flip": np.zeros(8)}, not_finite=odd) for seed in range(2))
    side = Side(label="exact", cases=cases)
    other = dataclasses.replace(side, cases=tuple(dataclasses.replace(c, model="m") for c in cases))
    found = {one.measure.metric: one for one in compare(side, other, bands=BANDS).compared}
    assert found["psnr"].verdict == "equal"
    assert math.isnan(found["psnr"].new_mean)


def test_two_rows_are_compared_where_each_side_has_one():
    base, new = drawn_pair(0, 1.0)
    cases = tuple(
        dataclasses.replace(c, measured=dataclasses.replace(c.measured, row="3dgs@affine"))
        for c in new.cases
    )
    found = compare(base, dataclasses.replace(new, cases=cases), bands=BANDS)
    assert {one.group.row for one in found.compared} == {"3dgs -> 3dgs@affine"}
    assert verdicts(found)["scene_0", "psnr"] == "better"


def test_an_empty_side_is_refused():
    base, _ = drawn_pair(0)
    with pytest.raises(DataError, match="empty: no case"):
        compare(base, Side(label="empty", cases=()))


def test_an_unknown_metric_is_refused_with_the_nearest():
    with pytest.raises(UsageError, match="did you mean 'psnr'"):
        compare(*drawn_pair(0), metrics=["psrn"])


def test_what_differed_is_told_once():
    base, new = drawn_pair(0)
    cases = tuple(
        dataclasses.replace(
            c, settings={"lr": 0.2, "new": True}, environment={"commit": "f00", "python": "3.11"}
        )
        for c in new.cases
    )
    found = compare(base, dataclasses.replace(new, cases=cases), bands=BANDS)
    assert [(d.kind, d.name, d.base, d.new, d.where) for d in found.differing] == [
        ("commit", "commit", "0123abcd", "f00", "everywhere"),
        ("settings", "lr", "0.1", "0.2", "everywhere"),
        ("settings", "new", "(none)", "True", "everywhere"),
    ]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("effect", [0.0, 0.4])
def test_swapped_sides_give_the_opposite_verdicts(seed: int, effect: float):
    base, new = drawn_pair(seed, effect)
    there, back = compare(base, new, bands=BANDS), compare(new, base, bands=BANDS)
    assert verdicts(back) == {k: OPPOSITE.get(v, v) for k, v in verdicts(there).items()}
    for one, other in zip(there.compared, back.compared, strict=True):
        assert one.estimate is not None
        assert other.estimate is not None
        assert one.estimate.mean == -other.estimate.mean
        assert one.p == pytest.approx(other.p)


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_cases_is_of_no_account(seed: int):
    base, new = drawn_pair(seed, 0.4)
    order = np.random.default_rng(seed).permutation(len(new.cases))
    mixed = dataclasses.replace(new, cases=tuple(new.cases[i] for i in order))
    assert compare(base, new, bands=BANDS).compared == compare(base, mixed, bands=BANDS).compared


@pytest.mark.parametrize("seed", range(12))
def test_another_metric_never_makes_an_undecided_one_worse_or_better(seed: int):
    base, new = drawn_pair(seed, 0.25)
    few = verdicts(compare(base, new, metrics=["psnr"], bands={}))
    many = verdicts(compare(base, new, metrics=METRICS, bands={}))
    for key, verdict in few.items():
        assert many[key] in {verdict, "undecided"}


def test_the_unit_of_a_ratio_is_of_no_account():
    """Sizes in MB or in bytes: the same verdict, p-value and per cent."""
    rng = np.random.default_rng(0)
    sizes = rng.normal([[10.0], [10.4]], 0.05, (2, 4))

    def side(label: str, values, factor: float) -> Side:
        cases = tuple(
            case("scene_0", seed, {"psnr": np.zeros(3)}, values={"disk_mb": factor * value})
            for seed, value in enumerate(values)
        )
        return Side(label=label, cases=cases)

    bands = {"disk_mb": band(0.01, "relative")}
    found = [
        compare(side("a", sizes[0], f), side("b", sizes[1], f), metrics=["disk_mb"], bands=bands)
        for f in (1.0, 2.0**20)
    ]
    one, other = (f.compared[0] for f in found)
    assert one.verdict == other.verdict == "worse"
    assert one.p == pytest.approx(other.p)
    assert one.estimate is not None
    assert math.exp(one.estimate.mean) == pytest.approx(1.04, abs=0.01)


@pytest.mark.slow
def test_ten_thousand_results_are_compared_in_seconds():
    """834 rows x scenes of two sides with six seeds each; CPU seconds, as the machine may be busy."""
    base, new = drawn_pair(0, 0.1, scenes=834, seeds=6, images=4)
    assert len(base.cases) + len(new.cases) > 10_000
    started = time.process_time()
    found = compare(base, new, bands=BANDS)
    assert len(found.compared) == 834 * 4
    assert time.process_time() - started < 10
