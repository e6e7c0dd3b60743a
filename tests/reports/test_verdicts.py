"""Verdicts: every one by hand, and the rates of wrong and missed ones by simulation."""

import dataclasses
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from splatproof.base.errors import UsageError
from splatproof.reports.claims.claim import Claim, load_claims
from splatproof.reports.measured import Measured
from splatproof.reports.statistics import POWER, Difference
from splatproof.reports.verdicts import SETTLED, Judged, further_gain, judge, other_length

CLAIM = Claim(paper="ours", text="a is better", row="a", other="b", metric="psnr", printed=1.0)
NAMES = tuple(f"view_{i}" for i in range(6))


def run(row: str, seed: int, scores, **changed: Any) -> Measured:
    """A finished run with a PSNR for each view."""
    images = {name: {"psnr": float(v)} for name, v in zip(NAMES, scores, strict=False)}
    values = {"psnr": float(np.mean(scores)), "disk_mb": 10.0, **changed.pop("values", {})}
    plain: dict[str, Any] = {"scene": "s", "row": row, "protocol": "p", "seed": seed, "steps": 10, "grown": 3,
                             "late_gain": 0.1, "values": values, "images": images, "data": "one"}  # fmt: skip
    return Measured(**{**plain, **changed})


def runs(effect: float, seeds: int = 3, noise: float = 0.05, **changed) -> list[Measured]:
    """Rows a and b; a is better by `effect` dB; images differ more than rows do."""
    rng = np.random.default_rng(5)
    hard = rng.normal(24, 3, len(NAMES))
    return [
        run(row, seed, hard + shift + rng.normal(0, noise, len(NAMES)), **changed)
        for row, shift in (("a", effect), ("b", 0.0))
        for seed in range(seeds)
    ]


def verdict(claim: Claim = CLAIM, found: list[Measured] | None = None) -> Judged:
    return judge(claim, runs(1.0) if found is None else found, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        (1.0, "holds"), (0.6, "holds"), (0.3, "direction only"), (0.0, "no difference"),
        (-0.5, "contradicted"),
    ],
)  # fmt: skip
def test_the_interval_decides(effect: float, expected: str):
    found = verdict(found=runs(effect))
    assert found.verdict == expected, found
    assert found.seeds == 3
    assert found.difference is not None
    assert found.difference.mean == pytest.approx(effect, abs=0.1)


@pytest.mark.parametrize(
    ("metric", "wall", "expected"),
    [
        ("train_seconds", 100.0, "holds"), ("train_seconds", 130.0, "not testable here"),
        ("disk_mb", 130.0, "holds"),
    ],
)  # fmt: skip
def test_times_of_a_machine_that_had_other_work_judge_nothing(metric, wall, expected):
    """Wall seconds beyond CPU seconds are waiting; sizes do not mind."""
    found = []
    for row, factor in (("a", 1.0), ("b", 2.0)):
        for seed in range(3):
            own = {"train_seconds": factor * wall + seed, "cpu_seconds": factor * 105.0,
                   "disk_mb": factor * 10 + 0.01 * seed}  # fmt: skip
            found.append(run(row, seed, [20.0] * 6, values=own))
    claim = dataclasses.replace(CLAIM, metric=metric, better="lower", relative=True, printed=-0.5)
    judged = verdict(claim, found)
    assert judged.verdict == expected, judged
    if expected != "holds":
        assert judged.reason == "a, b: timed while the machine had other work"


@pytest.mark.parametrize(
    ("sessions", "expected", "reason"),
    [
        (("one", "one"), "holds", ""),
        (("one", "two"), "not testable here", "a, b: its frames had turns with other rows"),
        (("one", ""), "not testable here", "a: its frames had turns with other rows"),
        (("", ""), "not testable here", "a, b: timed while the machine had other work"),
    ],
)  # fmt: skip
def test_frames_that_had_their_turns_together_are_judged_whatever_their_training_met(
    sessions, expected, reason
):
    found = [
        run(row, seed, [20.0] * 6, turns=session, values={
            "render_ms": factor * 10 + 0.1 * seed, "train_seconds": 300.0, "cpu_seconds": 100.0
        })
        for row, factor, session in zip("ab", (1.0, 2.0), sessions, strict=True)
        for seed in range(3)
    ]  # fmt: skip
    claim = dataclasses.replace(
        CLAIM, metric="render_ms", better="lower", relative=True, printed=-0.5
    )
    judged = verdict(claim, found)
    assert judged.verdict == expected, judged
    assert reason in judged.reason
    slower = dataclasses.replace(claim, metric="train_seconds")
    assert "timed while the machine had other work" in verdict(slower, found).reason


def test_a_frame_of_other_length_says_something_if_it_had_its_turn_in_the_same_session():
    rows = {"a": 10.0, "a@half": 4.0, "b": 20.0, "b@half": 19.0}
    found = {
        name: run(name, 0, [20.0] * 6, turns="one", values={"render_ms": ms})
        for name, ms in rows.items()
    }
    assert further_gain(found["a"], "render_ms", list(found.values())) == 6.0
    apart = [*found.values()]
    apart[1] = dataclasses.replace(apart[1], turns="two")
    assert math.isnan(further_gain(found["a"], "render_ms", apart))
    assert further_gain(found["b"], "render_ms", apart) == 1.0


UNCOUNTED = "b: recorded before the processes of blocks were counted"


@pytest.mark.parametrize(
    ("metric", "expected", "reason"),
    [
        ("train_seconds", "not testable here", f"{UNCOUNTED}: whether the machine had other work is not known"),
        ("seconds_max_over_mean", "not testable here",
         f"{UNCOUNTED}: whether the machine had other work is not known"),
        ("cpu_seconds", "not testable here", UNCOUNTED),
        ("peak_memory_mb", "not testable here", UNCOUNTED),
        ("cpu_max_over_mean", "holds", ""), ("disk_mb", "holds", ""),
    ],
)  # fmt: skip
def test_costs_without_the_processes_of_blocks_are_not_compared_and_the_reason_is_told(
    metric, expected, reason
):
    found = []
    for row, factor in (("a", 1.0), ("b", 2.0)):
        for seed in range(3):
            own = {name: factor * 100 + seed for name in (
                "train_seconds", "seconds_max_over_mean", "cpu_max_over_mean", "disk_mb")}  # fmt: skip
            if row == "a":
                own |= {"cpu_seconds": 100.0, "peak_memory_mb": 500.0}
            found.append(run(row, seed, [20.0] * 6, values=own, blocks_uncounted=row == "b"))
    claim = dataclasses.replace(CLAIM, metric=metric, better="lower", relative=True, printed=-0.5)
    judged = verdict(claim, found)
    assert (judged.verdict, judged.reason if reason else "") == (expected, reason)


def test_a_claim_that_less_is_better_turns_the_sides():
    less = dataclasses.replace(CLAIM, better="lower", printed=-1.0)
    assert verdict(less, runs(-1.0)).verdict == "holds"
    assert verdict(less, runs(-0.3)).verdict == "direction only"
    assert verdict(less, runs(0.5)).verdict == "contradicted"


def test_no_difference_says_what_would_have_shown():
    found = verdict(found=runs(0.0))
    assert found.difference is not None
    assert f"an effect of {found.difference.detectable:.2g} would have shown" in found.reason
    half = (found.difference.high - found.difference.low) / 2
    assert half < found.difference.detectable < 2 * half


def test_without_a_printed_size_the_direction_holds():
    assert verdict(dataclasses.replace(CLAIM, printed=None), runs(0.3)).verdict == "holds"


@pytest.mark.parametrize(
    ("effect", "bar", "expected"),
    [
        (2.5, 2.0, "holds"), (1.5, 2.0, "contradicted"), (2.0, 2.0, "undecided"),
        (-0.1, -0.2, "holds"), (-0.5, -0.2, "contradicted"),
    ],
)  # fmt: skip
def test_a_bar_asks_for_the_whole_interval(effect: float, bar: float, expected: str):
    claim = dataclasses.replace(CLAIM, printed=None, bar=bar)
    assert verdict(claim, runs(effect, noise=0.1)).verdict == expected


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [
        (0.31, "holds"), (0.6, "holds"), (0.9, "direction only"), (1.5, "contradicted"),
        (1.0, "no difference"),
    ],
)  # fmt: skip
def test_sizes_are_judged_as_ratios_over_seeds(ratio: float, expected: str):
    claim = dataclasses.replace(
        CLAIM, metric="disk_mb", better="lower", printed=-0.69, relative=True
    )
    found = runs(0.0)
    jitter = (0.99, 1.0, 1.01)
    found = [
        dataclasses.replace(one, values={"psnr": 20.0, "disk_mb":
            (ratio if one.row == "a" else 1.0) * 50 * jitter[one.seed]})
        for one in found
    ]  # fmt: skip
    got = verdict(claim, found)
    assert got.verdict == expected
    assert got.difference is not None
    assert claim.as_effect(got.difference.mean) == pytest.approx(ratio - 1, abs=1e-3)
    assert got.difference.images == 1
    if expected == "no difference":
        assert "%" in got.reason


def test_only_images_that_have_the_part_count():
    found = runs(0.0)
    moving = [
        dataclasses.replace(one, images={
            name: {**scores, **({"moving_psnr": 20.0 + (one.row == "a")} if name < "view_2" else {})}
            for name, scores in one.images.items()
        }) for one in found
    ]  # fmt: skip
    claim = dataclasses.replace(CLAIM, metric="moving_psnr")
    got = verdict(claim, moving)
    assert got.verdict == "holds"
    assert got.difference is not None
    assert got.difference.images == 2
    assert verdict(claim, found).verdict == "not testable here"


@pytest.mark.parametrize("odd", [math.inf, math.nan])
def test_scores_that_are_not_finite_are_not_judged(odd: float):
    claim = dataclasses.replace(CLAIM, metric="loss")
    found = [dataclasses.replace(one, values={"psnr": 20.0, "loss": odd}) for one in runs(0.0)]
    assert "not finite" in verdict(claim, found).reason


def test_an_image_that_one_run_has_no_score_of_is_not_left_out_of_the_mean():
    found = runs(1.0)
    failed = dataclasses.replace(found[1], images=found[1].images | {"view_3": {}})
    got = verdict(found=[found[0], failed, *found[2:]])
    assert got.verdict == "not testable here"
    assert got.reason == "a seed 1 has no finite psnr in view_3, which other runs have"


@pytest.mark.parametrize("share", [0.0, -0.1])
def test_what_is_not_above_zero_has_no_ratio(share: float):
    claim = dataclasses.replace(CLAIM, metric="whole", relative=True, printed=0.5)
    found = [
        dataclasses.replace(one, values={"psnr": 20.0, "whole": share if one.seed else 0.4})
        for one in runs(0.0)
    ]
    got = verdict(claim, found)
    assert got.verdict == "not testable here"
    assert got.reason == "whole is not above 0 in every run, and has no ratio"


def too_short(found: list[Measured], claim: Claim = CLAIM) -> str:
    got = verdict(claim, found)
    assert got.verdict == "too short to judge", got
    return got.reason


def test_too_short_to_judge():
    assert "2 seeds" in too_short(runs(1.0, seeds=2))
    assert "1 seed;" in too_short(runs(1.0, seeds=1))
    assert "never densified" in too_short(runs(1.0, grown=0))
    assert "training loss" in too_short(runs(0.1, late_gain=SETTLED + 0.1))
    failed = [dataclasses.replace(one, error="broke") if one.seed else one for one in runs(1.0)]
    assert "1 seed;" in too_short(failed)


@pytest.mark.parametrize(
    ("visits", "asked", "changed", "told"),
    [
        ((39, 80), 40, {}, "a: a photo was visited 39 times; 40 are needed"), ((40, 40), 40, {}, ""),
        ((39, 39), 0, {}, ""), ((39, 80), 40, {"fixed_length": True}, ""),
        ((39, 80), 40, {"before_training": True}, ""), ((None, None), 40, {}, ""),
        ((None, 3), 40, {}, "b: a photo was visited 3 times; 40 are needed"),
    ],
)  # fmt: skip
def test_rows_that_visit_a_photo_too_seldom_are_too_short(visits, asked, changed, told):
    """One seed is enough to be one; a record that does not say it is not judged by it."""
    least: dict[str, int | None] = dict(zip("ab", visits, strict=True))
    found = [
        one if (count := least[one.row]) is None
        else dataclasses.replace(one, counters={"least_visits": count + (one.seed != 1)})
        for one in runs(1.0)
    ]  # fmt: skip
    judged = verdict(dataclasses.replace(CLAIM, visits=asked, **changed), found)
    assert judged.verdict == ("too short to judge" if told else "holds")
    assert told in judged.reason


def with_halves(gain: float, effect: float = 0.1, metric: str = "psnr") -> list[Measured]:
    """Rows a and b, `effect` apart, and theirs with half the steps, which are `gain` worse."""
    found = runs(effect, late_gain=9.0, noise=0.0)
    halves = [
        dataclasses.replace(one, row=f"{one.row}@half", late_gain=0.0, values={
            name: value - (gain if name == metric else 0) for name, value in one.values.items()
        })
        for one in found if one.seed == 0
    ]  # fmt: skip
    return [*found, *halves]


def test_a_row_of_half_the_steps_says_better_than_the_loss_whether_a_run_had_settled():
    assert verdict(found=with_halves(SETTLED - 0.1)).verdict == "direction only"
    assert "further steps would change psnr by about +0.4" in too_short(with_halves(0.4))
    # what is still to come cannot turn a difference that is larger
    assert verdict(found=with_halves(0.4, effect=0.6)).verdict == "holds"
    assert verdict(found=with_halves(0.4, effect=-0.6)).verdict == "contradicted"
    # that scores fell says the run was long enough
    assert verdict(found=with_halves(-1.0)).verdict == "direction only"


@pytest.mark.parametrize(
    ("bar", "expected"),
    [
        (0.5, "holds"), (0.9, "too short to judge"), (1.2, "too short to judge"),
        (1.8, "contradicted"),
    ],
)  # fmt: skip
def test_what_is_still_to_come_is_held_against_what_parts_a_difference_from_its_bar(bar, expected):
    """Rows 1 dB apart, each with 0.4 dB to come, which cannot turn their order but may cross a bar that is near."""
    claim = dataclasses.replace(CLAIM, printed=None, bar=bar)
    assert verdict(claim, with_halves(0.4, effect=1.0)).verdict == expected


@pytest.mark.parametrize(
    ("changing", "effect", "expected"),
    [
        ("a", 1.0, "holds"), ("b", 1.0, "too short to judge"),
        ("a", 0.6, "too short to judge"), ("b", 0.6, "contradicted"),
    ],
)  # fmt: skip
def test_a_row_that_leads_away_from_the_bar_is_no_matter(changing, effect, expected):
    """A bar of 0.8 dB: what better rows become only makes more of what they lead by, and others less."""
    claim = dataclasses.replace(CLAIM, printed=None, bar=0.8)
    made = with_halves(0.5, effect)
    whole = {(one.row, one.seed): one.values for one in made}
    found = [
        one if one.row == f"{changing}@half" else
        dataclasses.replace(one, values=whole[one.row.removesuffix("@half"), one.seed])
        for one in made
    ]  # fmt: skip
    assert verdict(claim, found).verdict == expected


def test_a_claim_of_just_these_lengths_does_not_ask_what_further_steps_would_change():
    found = with_halves(9.0)
    assert "further steps" in too_short(found)
    fixed = dataclasses.replace(CLAIM, fixed_length=True)
    assert verdict(fixed, found).verdict == "direction only"
    assert "never densified" in too_short(runs(1.0, grown=0), fixed)


def test_a_row_of_twice_the_steps_says_it_better_than_one_of_half():
    """Each doubling is taken to give half as much as the one before: all to come is twice the next one."""
    still = with_halves(SETTLED + 1.0)

    def doubled(gain: float) -> list[Measured]:
        longer = [
            dataclasses.replace(one, row=f"{one.row}@double", late_gain=0.0, values={
                name: value + gain for name, value in one.values.items()
            })
            for one in still if one.seed == 0 and "@" not in one.row
        ]  # fmt: skip
        return [*longer, *still]

    assert verdict(found=doubled(SETTLED / 2 - 0.01)).verdict == "direction only"
    assert verdict(found=doubled(-1.0)).verdict == "direction only"
    assert "psnr by about +0.36" in too_short(doubled(0.18))
    without = [one for one in doubled(0.18) if not one.row.endswith("@half")]
    assert "psnr by about +0.36" in too_short(without)


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("a@ours", "+0.1"), ("a@ours-part", "+0.1"), ("a@ours-part-less~noise-L1", "+0.1"),
        ("a@our", "+2"), ("a@oursome", "+2"), ("a@n2-ours", "+2"), ("a", "+2"),
        # all that is still to come is what the second half of its steps gave
        ("a@double", "+1"), ("a@ours-double", "+0.05"),
        # run at twice the steps alone, it is taken to have gained as much as what it is a variant of
        ("a@ours-part-double", "+0.05"),
        # unless four times the steps are there
        ("a@long-double", "+0.4"), ("a@long", "+2"), ("a@long-double-double", "+0.2"),
        # its own half says more of it than twice the steps of its method
        ("a@quick", "+0.2"), ("a@quick-part", "+0.2"),
    ],
)  # fmt: skip
def test_a_variant_of_a_variant_needs_as_many_steps_as_that_where_it_is_known(row, told):
    """Its name begins with the other's; where no row says how long that takes, as many as the method."""
    lengths = [
        run(name, 0, [20.0 + gain] * 6)
        for name, gain in (
            ("a", 0), ("a@double", 1.0), ("a@ours", 0), ("a@ours-double", 0.05), ("a@ours-part-double", 3.0),
            ("a@quick", 0.2), ("a@quick-half", 0.0),
            ("a@long", 0.0), ("a@long-double", 1.0), ("a@long-double-double", 1.2),
        )
    ]  # fmt: skip
    found = further_gain(run(row, 0, [20.0] * 6), "psnr", lengths)
    assert f"{found:+.2g}" == told
    assert math.isnan(further_gain(run("c@ours", 0, [20.0] * 6), "psnr", lengths))


@pytest.mark.parametrize(
    ("variant", "of"),
    [
        ("double", ("", "double")), ("half", ("", "half")), ("ours-double", ("ours", "double")),
        ("n2-even-half", ("n2-even", "half")), ("ours", ("ours", "")), ("", ("", "")),
        ("doubled", ("doubled", "")), ("half-life", ("half-life", "")),
    ],
)  # fmt: skip
def test_the_end_of_a_variant_s_name_says_whether_its_length_is_another(variant, of):
    assert other_length(variant) == of


def test_of_several_scenes_what_the_second_half_gave_is_their_mean():
    """As of differences; a scene without rows of half the steps says nothing of it."""

    def on(scene: str, found: list[Measured]) -> list[Measured]:
        return [dataclasses.replace(one, scene=scene) for one in found]

    settled, rising = with_halves(SETTLED - 0.2), with_halves(SETTLED + 0.4)
    whole = [one for one in settled if not one.row.endswith("@half")]
    for first, second in ((settled, rising), (rising, settled)):
        assert f"{SETTLED + 0.1:+.2g}" in too_short([*on("s", first), *on("t", second)])
    for first, second in ((settled, whole), (whole, settled)):
        assert verdict(found=[*on("s", first), *on("t", second)]).verdict == "direction only"


@pytest.mark.parametrize("metric", ["seam_psnr_partition", "seam_psnr_released", "psnr_60s"])
def test_a_psnr_over_some_pixels_or_after_some_seconds_settles_as_any_psnr_does(metric):
    claim = dataclasses.replace(CLAIM, metric=metric, printed=None)

    def reason(gain: float) -> str:
        found = [
            dataclasses.replace(
                one,
                values={metric: one.values["psnr"]},
                images={name: {metric: scores["psnr"]} for name, scores in one.images.items()},
            )
            for one in with_halves(gain, effect=0.1)
        ]
        return verdict(claim, found).reason

    assert f"further steps would change {metric}" in reason(SETTLED + 0.1)
    assert "further steps" not in reason(SETTLED - 0.1)  # more than a hundredth of 20 dB
    assert "further steps" not in reason(-1.0)


def test_sizes_have_to_have_settled_too():
    claim = dataclasses.replace(
        CLAIM, metric="disk_mb", better="lower", printed=-0.5, relative=True
    )
    assert verdict(claim, with_halves(0.9, metric="disk_mb")).verdict == "no difference"
    for gain in (2.0, -2.0):
        assert "disk_mb by" in too_short(with_halves(gain, metric="disk_mb"), claim)
    smaller = [
        dataclasses.replace(one, values={**one.values, "disk_mb": 5.0}) if one.row == "a" else one
        for one in with_halves(2.0, metric="disk_mb")
    ]
    assert "b: further steps" not in verdict(claim, smaller).reason
    assert "training loss" in too_short(runs(0.0, late_gain=9.0), claim)


@pytest.mark.parametrize(
    ("share", "expected"), [(0.5, "holds"), (0.47, "holds"), (0.3, "too short to judge")]
)
def test_a_sum_over_steps_has_not_changed_where_half_the_steps_have_half_of_it(share, expected):
    """Row a takes 1.2 times as long; where its first half took far less, it was still growing."""
    found = []
    for row, seconds in (("a", 120.0), ("b", 100.0)):
        for seed in range(3):
            own = {"cpu_seconds": seconds + 0.1 * seed}
            found.append(run(row, seed, [20.0] * 6, values=own))
        half = {"cpu_seconds": (share if row == "a" else 0.5) * seconds}
        found.append(run(f"{row}@half", 0, [20.0] * 6, values=half))
    claim = dataclasses.replace(
        CLAIM, metric="cpu_seconds", better="lower", relative=True, bar=0.3, printed=None
    )
    assert verdict(claim, found).verdict == expected
    far = dataclasses.replace(claim, bar=1.0)  # what is still to come does not reach twice
    assert verdict(far, found).verdict == "holds"


def test_a_variant_needs_as_many_steps_as_its_method():
    def renamed(row: str) -> list[Measured]:
        return [
            dataclasses.replace(one, row=row) if one.row == "a" else one for one in with_halves(0.4)
        ]

    for row in ("b@no-x", "b~depth-oracle"):
        claim = dataclasses.replace(CLAIM, row=row)
        assert f"{row}: further steps" in too_short(renamed(row), claim)
    # a row of half the steps with the same prior says more than one without
    found = renamed("b~depth-oracle")
    own = [dataclasses.replace(one, row="b@half~depth-oracle", values=found[0].values)
           for one in found if one.row == "b@half"]  # fmt: skip
    assert "b~depth-oracle" not in too_short([*found, *own], claim)


def test_not_testable_here():
    other = [dataclasses.replace(one, data="two") if one.row == "a" else one for one in runs(1.0)]
    only_a = [one for one in runs(1.0) if one.row == "a"]
    mixed = [*runs(1.0), *runs(1.0, protocol="q")]
    elsewhere = [
        *runs(1.0), *(dataclasses.replace(one, scene="t") for one in only_a)
    ]  # fmt: skip
    for found, claim, said in (
        (runs(1.0), dataclasses.replace(CLAIM, missing="no weights"), "no weights"),
        (only_a, CLAIM, "b has not been run"),
        ([], CLAIM, "a has not been run"),
        ([dataclasses.replace(one, error="broke") for one in runs(1.0)], CLAIM, "a failed: broke"),
        (other, CLAIM, "other images"),
        (mixed, CLAIM, "several protocols"),
        (elsewhere, CLAIM, "b has not been run on t"),
        (runs(1.0), dataclasses.replace(CLAIM, metric="lpips"), "no image has lpips"),
    ):
        got = verdict(claim, found)
        assert (got.verdict, got.difference) == ("not testable here", None)
        assert said in got.reason
    assert verdict(dataclasses.replace(CLAIM, protocol="q"), mixed).verdict == "holds"
    assert verdict(dataclasses.replace(CLAIM, scenes=("s",)), elsewhere).verdict == "holds"


def simulated(rng: np.random.Generator, effect: float) -> list[Measured]:
    """An experiment of three seeds: images vary a lot, seeds of a row a little."""
    hard = rng.normal(24, 3, len(NAMES))
    found = []
    for row, shift in (("a", effect), ("b", 0.0)):
        for seed in range(3):
            moved = rng.normal(shift, 0.2) + rng.normal(0, 0.3, len(NAMES))
            found.append(run(row, seed, hard + moved))
    return found


def simulate(effect: float, repeats: int) -> tuple[Counter, list[Difference]]:
    rng = np.random.default_rng(3)
    every = [judge(CLAIM, simulated(rng, effect), rng) for _ in range(repeats)]
    differences = [one.difference for one in every if one.difference is not None]
    return Counter(one.verdict for one in every), differences


def test_false_alarms_are_as_rare_as_stated_and_planted_effects_as_often_seen():
    repeats, fewer = 1000, 400
    nothing, differences = simulate(0.0, repeats)
    assert sum(nothing.values()) == repeats
    assert nothing["no difference"] / repeats >= 0.95 - 3 * math.sqrt(0.05 * 0.95 / repeats)
    # the root of the mean square: an interval's width scatters, and so does what it promises
    planted = math.sqrt(np.mean([one.detectable**2 for one in differences]))
    seen, _ = simulate(planted, fewer)
    power = (seen["holds"] + seen["direction only"]) / fewer
    assert power == pytest.approx(POWER, abs=0.05 + 3 * math.sqrt(0.8 * 0.2 / fewer))
    assert not seen["contradicted"]
    weak, _ = simulate(planted / 3, fewer)  # a control: less is seen less often
    assert (weak["holds"] + weak["direction only"]) / fewer < 0.4


def test_claims_that_cannot_be_meant_are_refused():
    with pytest.raises(UsageError, match="printed -1.0 is not higher"):
        dataclasses.replace(CLAIM, printed=-1.0)
    with pytest.raises(UsageError, match="bar -2.0: a ratio is above -1"):
        dataclasses.replace(CLAIM, printed=None, relative=True, bar=-2.0)
    with pytest.raises(UsageError, match="claims: unknown 'stret', did you mean 'street'"):
        load_claims("stret", ())
