"""Results as a table: nothing is lost, nothing is invented, and pandas can work with it."""

import dataclasses
import math

import numpy as np
import pytest

from helpers.case_folders import NAMES, result
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import Result
from splatproof.reports.frames import IDENTITY, cases_of, results_frame
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.store import StoredResult


def some() -> list[Result]:
    return [
        result(scene=scene, method=method, seed=seed)
        for scene in ("town", "beach")
        for method in ("3dgs", "other")
        for seed in range(3)
    ]


def test_one_row_an_image_with_all_that_is_known_of_it():
    results = some()
    frame = results_frame(results)
    assert len(frame) == len(results) * len(NAMES)
    assert list(frame.columns[: len(IDENTITY)]) == IDENTITY
    assert frame.columns.is_unique
    assert frame.index.tolist() == list(range(len(frame)))
    for i, one in enumerate(results):
        for j, image in enumerate(one.images):
            line = frame.iloc[i * len(NAMES) + j]
            assert (line["scene"], line["method"], line["seed"]) == (
                one.scene,
                one.method,
                one.seed,
            )
            assert (line["image"], line["psnr"]) == (image.name, image.metrics["psnr"])
            assert line["truth_sha256"] == image.truth_sha256
            assert line["case.psnr"] == one.metrics["psnr"]
            assert line["train_seconds"] == one.training_seconds
            assert line["seconds.load"] == 1.0
            assert line["bytes_on_disk"] == one.bytes_on_disk
            assert line["settings.densify.grad_threshold"] == 2e-4
            assert line["environment.torch"] == "2.13.0"
            assert line["facts.units"] == "metres"


def test_stored_results_give_the_frame_of_their_results(stored: list[StoredResult]):
    frame = results_frame(stored)
    assert frame.equals(results_frame(one.result for one in stored))
    assert set(frame["scene"]) == {"town", "beach"}


def test_means_are_a_groupby_away():
    results = some()
    frame = results_frame(results)
    means = frame.pivot_table(index="row", columns="scene", values="psnr")
    want = np.mean([r.metrics["psnr"] for r in results if (r.scene, r.row) == ("town", "3dgs")])
    assert means.loc["3dgs", "town"] == pytest.approx(want)
    assert len(cases_of(frame)) == len(results)


def test_cases_with_other_settings_rules_or_metrics_stand_side_by_side():
    one = dataclasses.replace(result(), settings={"iterations": 7000, "marks": [1, 2]})
    rules = Protocol(name="other", source="ours", metrics=("psnr",))
    other = dataclasses.replace(
        result(protocol=rules), settings={"rate": 0.5}, metrics={"psnr": 20.0, "seam_psnr": 18.0}
    )
    failed = dataclasses.replace(
        result(seed=7), images=(), metrics={}, stages={}, error="out of memory", settings={}
    )
    frame = results_frame([one, other, failed])
    assert len(cases_of(frame)) == 3
    first, second, last = (own.iloc[0] for _, own in frame.groupby("case", sort=False))
    # as it was set: a column with gaps does not make a float of a whole number
    assert first["settings.iterations"] == 7000
    assert isinstance(first["settings.iterations"], int)
    assert first["settings.marks"] == [1, 2]
    assert first["settings.rate"] is None
    assert math.isnan(first["case.seam_psnr"])
    assert second["case.seam_psnr"] == 18.0
    assert (frame["case"] == last["case"]).sum() == 1
    assert last["error"] == "out of memory"
    assert math.isnan(last["psnr"])
    assert frame["image"].isna().tolist() == [False] * 8 + [True]


def test_nothing_is_an_empty_frame_and_no_table():
    frame = results_frame([])
    assert len(frame) == 0
    assert [name for name in IDENTITY if name not in frame.columns] == []
    assert build_tables([]) == []


def test_tables_read_the_frame_in_the_order_of_seeds_and_images():
    """Ragged orders of results and images do not pair one image with another."""
    results = some()
    shuffled = [
        dataclasses.replace(one, images=one.images[::-1] if one.seed % 2 else one.images)
        for one in results[::-1]
    ]
    for got, want in zip(build_tables(shuffled), build_tables(results), strict=True):
        assert got.differences == want.differences != ()
        assert [row.cells for row in got.rows] == [row.cells for row in want.rows]
        assert [row.label for row in got.rows] == [row.label for row in want.rows]


def test_a_case_that_is_given_twice_counts_once():
    (table,) = build_tables([result(seed=seed) for seed in (0, 1, 2, 2)])
    assert table.rows[0].seeds == 3
