"""What is read off a result: growth, whether its curve is flat, and the data behind it."""

import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.case_folders import NAMES
from helpers.case_folders import result as result_of
from splatproof.reports.measured import Measured, late_gain, loss_points, measured, times_grown


def test_a_result_as_plain_data():
    found = measured(
        result_of(
            seed=2,
            variant="x",
            metrics={"psnr": 20.123456789, "lpips": math.nan},
            environment={"cores": "2", "simd": "avx2", "python": "3"},
            bytes_on_disk=2**21,
            counters={"steps": 2000, "pairs": 123_456_789_012},
            render_ms=20.0,
        )
    )
    assert (found.scene, found.row, found.seed) == ("town", "3dgs@x", 2)
    assert (found.steps, found.machine) == (2000, "cores 2, simd avx2")
    assert (found.values["psnr"], found.values["disk_mb"], found.values["render_ms"]) == (
        20.1235,
        2.0,
        20.0,
    )
    assert (found.values["train_seconds"], found.values["cpu_seconds"]) == (33.0, 70.0)
    assert found.counters == {"pairs": 123_456_789_012, "steps": 2000}  # exact, not rounded
    assert "lpips" not in found.values
    assert set(found.images) == set(NAMES)
    assert Measured(**json.loads(json.dumps(dataclasses.asdict(found)))) == found


@pytest.mark.parametrize(
    ("settings", "cpu", "uncounted"),
    [({"blocks": 4}, 6.0, True), ({"blocks": 4}, 49.9, True), ({"blocks": 4}, 50.1, False), ({}, 6.0, False)],
)  # fmt: skip
def test_costs_of_records_without_the_processes_of_blocks_are_left_out(settings, cpu, uncounted):
    stages = {"coarse": 40.0, "blocks": 60.0, "train": 110.0}
    found = measured(result_of(settings=settings, cpu_seconds=cpu, stages=stages))
    assert found.blocks_uncounted == uncounted
    assert {"cpu_seconds", "peak_memory_mb"} & set(found.values) == (
        set() if uncounted else {"cpu_seconds", "peak_memory_mb"}
    )
    assert found.values["train_seconds"] == 110.0


@pytest.mark.parametrize(
    ("row", "plain", "half"),
    [
        ("a", "a", "a@half"), ("a@x", "a", "a@half"),
        ("a@x~depth-oracle+noise", "a~depth-oracle+noise", "a@half~depth-oracle+noise"),
    ],
)  # fmt: skip
def test_rows_of_the_same_method(row: str, plain: str, half: str):
    one = Measured(scene="s", row=row, protocol="p", seed=0, steps=1)
    assert (one.named(), one.named("half")) == (plain, half)
    assert one.named("x", axes="") == "a@x"


def test_other_pixels_or_another_split_are_other_data():
    one = result_of()
    image = one.images[0]
    pixels = dataclasses.replace(
        one, images=(dataclasses.replace(image, truth_sha256="0"), *one.images[1:])
    )
    split = dataclasses.replace(one, split_sha256="0")
    scores = dataclasses.replace(
        one, images=tuple(dataclasses.replace(image, metrics={"psnr": 1.0}) for image in one.images)
    )
    digests = [measured(each).data for each in (one, pixels, split, scores)]
    assert len(set(digests[:3])) == 3
    assert digests[3] == digests[0]


def curve(losses: list[float], counts: list[float] | None = None):
    counts = counts or [1.0] * len(losses)
    return [
        (10 * (i + 1), {"loss": x, "gaussians": n})
        for i, (x, n) in enumerate(zip(losses, counts, strict=True))
    ]


def test_growth_is_counted_and_pruning_is_not():
    assert times_grown(curve([1.0] * 6, [5, 5, 7, 6, 9, 9])) == 2
    assert times_grown(curve([1.0] * 3, [5, 4, 4])) == 0
    assert times_grown([(10, {"loss": 1.0})]) == times_grown([]) == 0


def test_a_model_begins_with_what_its_curve_begins_with():
    assert measured(result_of(curve=tuple(curve([1.0] * 3, [5.0, 9.0, 4.0])))).values["points"] == 5
    assert "points" not in measured(result_of(curve=((10, {"loss": 1.0}),))).values
    blocks = {"iterations": 5, "blocks": 2}  # the first point is of one block
    whole = result_of(curve=tuple(curve([1.0] * 2, [5.0, 9.0])), settings=blocks)
    assert "points" not in measured(whole).values


def test_the_late_gain_is_of_the_last_fifth_over_the_one_before():
    flat = curve([9.0] * 6 + [2.0, 2.0] + [1.0, 1.0])  # steps 70 and 80 against 90 and 100
    assert late_gain(flat) == pytest.approx(20 * math.log10(2))
    assert late_gain(curve([1.0] * 10)) == 0
    assert late_gain(curve([1.0] * 8 + [2.0] * 2)) < 0
    for short in ([], curve([1.0]), [(10, {"gaussians": 3.0})]):
        assert late_gain(short) == math.inf


def test_the_difference_from_photos_counts_alone_where_it_is_known():
    both = [
        (step, {**values, "loss": 1.0, "photometric": values["loss"]})
        for step, values in curve([1.0] * 8 + [0.5] * 2)
    ]
    assert late_gain(both) == pytest.approx(20 * math.log10(2))
    assert loss_points(both) == loss_points(curve([1.0] * 8 + [0.5] * 2))


def test_a_failed_case_is_plain_json():
    failed = dataclasses.replace(result_of(), error="no point is seen", curve=(), metrics={})
    assert json.dumps(dataclasses.asdict(measured(failed)), allow_nan=False)


@given(st.lists(st.floats(0.01, 1), min_size=10, max_size=40), st.floats(0.1, 10))
def test_the_late_gain_has_no_unit(losses: list[float], factor: float):
    scaled = [factor * x for x in losses]
    assert late_gain(curve(scaled)) == pytest.approx(late_gain(curve(losses)), abs=1e-9)


def test_growth_that_removal_hides_is_growth():
    fallen = tuple(curve([1.0] * 3, [9.0, 7.0, 6.0]))
    assert measured(result_of(curve=fallen, counters={"rows_added": 2})).grown == 1
    assert measured(result_of(curve=fallen, counters={"rows_added": 0})).grown == 0
    blocks = {"iterations": 5, "blocks": 2}  # what the coarse model added is no block's growth
    assert measured(result_of(curve=fallen, counters={"rows_added": 2}, settings=blocks)).grown == 0


def test_a_block_that_begins_is_no_growth():
    """The count of a scene in blocks is their sum: it goes up by a whole block when one begins."""
    counts = [100.0, 100.0, 250.0, 250.0]  # two blocks that never grow, one after the other
    curve = tuple((step, {"gaussians": n}) for step, n in enumerate([0.0, *counts]))
    grown = (*curve, (9, {"gaussians": 260.0}))
    blocks = {"iterations": 5, "blocks": 2}
    assert measured(result_of(curve=curve, settings=blocks)).grown == 0
    assert measured(result_of(curve=grown, settings=blocks)).grown == 1
    assert measured(result_of(curve=curve, settings={"iterations": 5})).grown == 2
