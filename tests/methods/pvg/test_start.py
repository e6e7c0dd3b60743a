"""What pvg starts from: points that stay for long, returns of what moves at their moment."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_drive import MOVING, tiny_drive
from splatproof.base.errors import DataError
from splatproof.methods.dynamic.sweep_points import TimedPoints
from splatproof.methods.dynamic.times import clock_of
from splatproof.methods.pvg import start
from splatproof.methods.pvg.settings import Settings, Start
from splatproof.methods.pvg.start import by_moment, choose, started


def points(count: int, moved: int) -> TimedPoints:
    return TimedPoints(
        positions=torch.arange(3.0 * count).reshape(-1, 3).double(),
        colours=torch.arange(3 * count).reshape(-1, 3).byte(),
        seconds=torch.tensor([0.1 * (i % 3) for i in range(count)]).double(),
        moved=torch.arange(count) < moved,
        velocities=(torch.arange(count) * (torch.arange(count) < moved))[:, None]
        * torch.tensor([1.0, 0.0, -2.0]),
    )


def test_what_moved_comes_first_and_the_others_are_drawn():
    chosen = choose(points(100, 20), 50, seed=1)
    assert len(chosen) == 50
    assert int(chosen.moved.sum()) == 20
    assert chosen.positions.unique(dim=0).shape == (50, 3)
    assert not torch.equal(chosen.positions, choose(points(100, 20), 50, seed=2).positions)
    assert torch.equal(chosen.positions, choose(points(100, 20), 50, seed=1).positions)
    few = choose(points(100, 20), 5, seed=1)
    assert few.moved.all()
    assert len(few) == 5
    assert len(choose(points(10, 2), 50, seed=1)) == 10


def test_groups_are_moments_of_what_moved_and_the_rest():
    groups = by_moment(points(12, 6))
    assert [len(group) for group in groups] == [6, 2, 2, 2]
    assert not groups[0].moved.any()
    assert all(len(group.seconds.unique()) == 1 for group in groups[1:])
    assert by_moment(points(3, 0).take(torch.zeros(0, dtype=torch.int64))) == []


def test_sparse_points_stay_and_returns_that_moved_have_their_moment(monkeypatch):
    scene, settings = tiny_drive(), Settings(start=Start(sweep_points=40))
    found = points(60, 9)
    monkeypatch.setattr(start, "in_motion", lambda points, up: found)
    clock = clock_of(scene)
    rows = started(scene, settings, clock, seed=0).rows
    sparse = len(scene.points)
    assert len(rows["means"]) == sparse + 40
    peaks, spans = rows["peaks"], rows["log_spans"].exp()
    stays, moves = slice(0, sparse + 31), slice(sparse + 31, None)
    assert not peaks[stays].any()
    torch.testing.assert_close(spans[stays], torch.full((sparse + 31,), clock.duration))
    torch.testing.assert_close(spans[moves], torch.full((9,), 0.04))
    wanted = torch.tensor([clock.at(t) for t in (0.0, 0.1, 0.2) for _ in range(3)])
    torch.testing.assert_close(peaks[moves], wanted)
    means = rows["means"][moves].double()
    assert set(map(tuple, means.tolist())) == set(map(tuple, found.positions[:9].tolist()))
    # 0.1 s between moments are 0.02 of model time: 1 unit a second is 5 a unit of it
    by_time = [0, 3, 6, 1, 4, 7, 2, 5, 8]
    torch.testing.assert_close(rows["velocities"][moves], 5 * found.velocities[by_time])
    assert not rows["velocities"][stays].any()
    resting = replace(settings, start=Start(sweep_points=40, velocities=False))
    assert not started(scene, resting, clock, seed=0).rows["velocities"].any()


def test_without_returns_no_sweep_is_read():
    scene = tiny_drive()
    bare = replace(scene, views=tuple(replace(view, load_sweep=None) for view in scene.views))
    none = Settings(start=Start(sweep_points=0))
    parameters = started(bare, none, clock_of(scene), seed=0)
    assert len(parameters) == len(scene.points)
    assert parameters.shared["sky"].shape == (6, 64, 64, 3)
    with pytest.raises(DataError, match="set lidar.weight = 0 and start.sweep_points = 0"):
        started(bare, Settings(), clock_of(scene), seed=0)


def test_returns_of_a_drive_become_gaussians():
    scene = tiny_drive()
    rows = started(scene, Settings(), clock_of(scene), seed=0).rows
    assert len(rows["means"]) > len(scene.points) + 7 * MOVING
