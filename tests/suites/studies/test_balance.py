"""The study of block times: dense scenes, turns, and what is made of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.city_scene import small_scene
from splatproof.methods.city.block_work import STEP_COST
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.reference.partition.block_time import BlockWork, block_seconds
from splatproof.suites.studies import balance
from splatproof.suites.studies.balance import Timed, fitted, interval, measured, thickened
from splatproof.suites.studies.balance_plot import draw

SCENE = small_scene(60)


def test_copies_lie_at_their_point_on_its_surface_and_are_seen_by_its_views():
    generator = torch.Generator().manual_seed(0)
    flat = SCENE.points.positions.clone()
    flat[:, 2] = 0.5 * flat[:, 0]  # a slope
    scene = replace(SCENE, points=replace(SCENE.points, positions=flat))
    found = thickened(scene, 5, generator).points
    assert len(found) == 5 * len(scene.points)
    assert torch.allclose(found.positions[:, 2], 0.5 * found.positions[:, 0], atol=1e-9)
    apart = torch.cdist(flat, flat) + 1e9 * torch.eye(len(flat))
    moved = (found.positions.view(-1, 5, 3) - flat[:, None]).norm(dim=2)
    assert bool((moved <= 0.5 * 2**0.5 * apart.amin(dim=1)[:, None] + 1e-9).all())
    assert bool((moved.amax(dim=1) > 0).all())
    starts, views = scene.points.track_starts.tolist(), scene.points.track_views.tolist()
    for row in range(len(found)):
        a, b = found.track_starts[row : row + 2].tolist()
        source = row // 5
        assert found.track_views[a:b].tolist() == views[starts[source] : starts[source + 1]]


def test_dense_jobs_are_the_cut_of_the_sparse_points():
    found = partition(SCENE, 2, PartitionSettings(seeds=1))
    jobs = balance.dense_jobs(SCENE, found, 4)
    assert [job.facts.points for job in jobs] == [
        4 * int((found.labels == block).sum()) for block in range(2)
    ]
    assert [job.facts.views for job in jobs] == [int(views.sum()) for views in found.views]


def test_a_row_has_what_blocks_took_by_turns():
    row, timed = measured(SCENE, "odbp, by time", blocks=2, each=60, turns=2)
    assert timed.seconds.shape == (2, 2)
    assert bool((timed.seconds > 0).all())
    assert row["slowest"] == pytest.approx(timed.seconds.mean(axis=0).max())
    assert 1 <= row["low"] <= row["max_over_mean"] * 1.0001
    assert row["max_over_mean"] <= row["high"] * 1.0001
    assert 1 <= row["predicted"] < 2
    assert [one["steps"] for one in row["blocks"]] == [work.steps for work in timed.works]


def test_the_picture_shows_what_was_measured(tmp_path):
    works = [
        dict(zip(("steps", "pixels", "gaussians", "pairs"), (20.0, 1e5, g, 5e4), strict=True))
        for g in (1e5, 2e5)
    ]
    row = {"scene": "s", "partition": "odbp", "max_over_mean": 1.2, "low": 1.1, "high": 1.3, "predicted": 1.1,
           "blocks": [one | {"seconds": 1.0} for one in works]}  # fmt: skip
    fit = {"scene": "all", "partition": "fit", "pixel": 1e-7, "gaussian": 1e-7, "pair": 2e-7}
    for rows in ([row], [row, fit]):
        (path,) = draw(rows, tmp_path)
        assert path.stat().st_size > 5000
    assert draw([fit], tmp_path) == []


def test_noise_of_single_turns_is_no_spread():
    rng = np.random.default_rng(0)
    even = 1 + 0.2 * rng.standard_normal((400, 4))
    low, high = interval(even)
    assert low < 1.02
    assert high < 1.05
    slow = even + np.array([0.3, 0, 0, 0])
    low, high = interval(slow)
    assert low < 1.3 / 1.075 < high


def test_the_fit_says_how_far_it_and_the_shipped_coefficients_are_off():
    rng = np.random.default_rng(0)
    works = tuple(
        BlockWork(**dict(zip(("steps", "pixels", "gaussians", "pairs"), values, strict=True)))
        for values in rng.uniform([20, 1e5, 1e5, 5e4], [40, 2e5, 8e5, 3e5], (8, 4)).tolist()
    )
    seconds = np.array([[3 * block_seconds(one, STEP_COST) for one in works]] * 2)
    row = fitted([Timed(works=works, seconds=seconds)])
    assert row["pair"] == pytest.approx(3 * STEP_COST.pair)
    assert "mean error 0 %" in row["note"]
    assert "in this machine's unit 0 %" in row["note"]
    assert "nothing" in fitted([])["note"]


def test_a_scene_that_is_not_here_is_said(monkeypatch):
    monkeypatch.setattr(balance, "SCENES", {"seneca": "city_400"})
    monkeypatch.setenv("SPLATPROOF_DATA", "/nowhere")
    rows = list(balance.rows(quick=False))
    assert [row["scene"] for row in rows] == ["seneca", "all"]
    assert "seneca" in rows[0]["note"]
