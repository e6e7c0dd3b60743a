"""Where anchors start: one a voxel, what moves at a moment of its own with its velocity."""

import torch

from helpers.tiny_drive import SPEED, tiny_drive
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.sweep_points import TimedPoints
from splatproof.methods.hdgs import fit as starting
from splatproof.methods.hdgs.fit import prepare
from splatproof.methods.hdgs.settings import Settings
from splatproof.methods.hdgs.start import cells_of, drawn_offsets, sites, started, voxel_for
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings


def points(positions, seconds, moved, velocities=None) -> TimedPoints:
    count = len(positions)
    return TimedPoints(
        positions=torch.tensor(positions).double(),
        colours=torch.tensor([[0, 51, 255]] * count, dtype=torch.uint8),
        seconds=torch.tensor(seconds).double(), moved=torch.tensor(moved),
        velocities=torch.tensor(velocities or [[0.0, 0, 0]] * count),
    )  # fmt: skip


def test_what_stands_still_is_the_mean_of_its_voxel_and_peaks_in_the_middle():
    found = sites(
        points([[0.2, 0.4, 0.4], [0.4, 0.6, 0.4], [3.4, 0.2, 0.2]], [5.0, 7.0, 9.0], [False] * 3),
        1.0, middle=0.5,
    )  # fmt: skip
    want = torch.tensor([[0.3, 0.5, 0.4], [3.4, 0.2, 0.2]]).double()
    torch.testing.assert_close(found.centres, want, atol=1e-6, rtol=0)
    assert found.times.tolist() == [0.5, 0.5]
    assert not found.moves.any()
    torch.testing.assert_close(found.colours[0], torch.tensor([0, 0.2, 1]).double())


def test_what_moves_has_finer_voxels_each_of_the_moment_of_its_first_point():
    found = sites(
        points(
            [[0.2, 0.2, 0.2], [0.3, 0.2, 0.2], [0.2, 0.3, 0.2], [0.8, 0.2, 0.2], [0.1, 0.1, 0.1]],
            [2.0, 1.0, 2.0, 1.0, 0.0], [True, True, True, True, False],
            [[4.0, 0, 0], [9, 0, 0], [6, 0, 0], [1, 0, 0], [0, 0, 0]],
        ), 1.0, middle=0.0,
    )  # fmt: skip
    assert found.times.tolist() == [2.0, 1.0]
    torch.testing.assert_close(found.velocities[:, 0], torch.tensor([5.0, 1.0]).double())
    want = torch.tensor([[0.2, 0.25, 0.2], [0.8, 0.2, 0.2]]).double()
    torch.testing.assert_close(found.centres, want, atol=1e-6, rtol=0)
    assert found.moves.all()  # what stands still leaves that voxel to what moves


def test_an_anchor_never_leaves_its_voxel_and_none_has_two():
    generator = torch.Generator().manual_seed(0)
    where = (6 * torch.rand(400, 3, generator=generator) - 3).tolist()
    edges = [[1.0 - 1e-9, 0.5, 0.5]]  # the mean of one point on the border
    moved = [index % 3 == 0 for index in range(400)]
    times = [float(index % 5) for index in range(400)]
    found = sites(points(where + edges, [*times, 0.0], [*moved, False]), 1.0, middle=0.0)
    cells = cells_of(found.centres.float(), 0.5)
    assert len(torch.unique(cells, dim=0)) == len(cells)


def test_the_voxel_is_the_smallest_that_leaves_so_few():
    generator = torch.Generator().manual_seed(0)
    where = torch.rand(2000, 3, generator=generator).double()
    edge = voxel_for(where, 100)
    held = [len(torch.unique(cells_of(where, e), dim=0)) for e in (edge, 0.9 * edge)]
    assert held[0] <= 100 < held[1]


def test_a_drive_starts_with_what_moves_at_its_velocity_and_moment(monkeypatch):
    swept = points(
        [[9.0, 0, 0], [0, 9.0, 0]], [0.1, 0.6], [True, False], [[SPEED, 0, 0]] + [[0] * 3]
    )
    monkeypatch.setattr(starting, "timed_points", lambda scene: swept)
    monkeypatch.setattr(starting, "in_motion", lambda points, up: points)
    settings = Settings(iterations=9, anchors=60)
    model, _ = prepare(tiny_drive(), settings, Run(threads=1))
    rows = model.parameters.rows
    (moving,) = torch.where(rows["velocities"].norm(dim=1) > 0)
    assert len(moving) == 1
    # a unit of the model's time is ten frames, here a second
    speed = rows["velocities"][moving[0], 0] * model.frame.unit
    assert abs(float(speed) - SPEED) < 1e-4
    place = model.frame.outwards(model.parameters.labels["centres"][moving[0]])
    torch.testing.assert_close(place, torch.tensor([9.0, 0, 0]), atol=0.02, rtol=0)
    # at its moment it is there, alive, and later it is where its velocity brings it
    at = [model.time(view) for view in tiny_drive().views[1:3]]
    assert abs(at[0] - float(rows["peaks"][moving[0]])) < 1e-5
    assert abs(float(rows["log_spans"][moving[0]].exp()) - settings.moving_span) < 1e-5
    still = torch.arange(len(rows["peaks"])) != moving[0]
    duration = at[1] - at[0]
    torch.testing.assert_close(
        rows["log_spans"][still].exp(), torch.full((int(still.sum()),), 7 * duration)
    )
    assert (rows["peaks"][still] == 0).all()


def test_scales_come_from_neighbours_of_the_same_moment():
    two = sites(
        points([[0.0, 0, 0], [2.0, 0, 0], [0.0, 1, 0], [5.0, 1, 0]], [1.0, 1, 2, 2], [True] * 4),
        1.0, middle=0.0,
    )  # fmt: skip
    sizes = HierarchySettings()
    made = started(
        two, sizes, spans=torch.ones(4), lone=1.0, shared={}, generator=torch.Generator()
    )
    scales = made.rows["log_scales"].exp()[:, 0]
    by_time = {float(t): float(s) for t, s in zip(made.rows["peaks"], scales, strict=True)}
    assert abs(by_time[1.0] - 2) < 0.05
    assert abs(by_time[2.0] - 5) < 0.05


def test_siblings_start_apart():
    offsets = drawn_offsets(HierarchySettings(layers=4), 3, torch.Generator().manual_seed(0))
    assert {name: tuple(v.shape) for name, v in offsets.items()} == {
        "offsets1": (3, 2, 3), "offsets2": (3, 4, 3), "offsets3": (3, 12, 3)
    }  # fmt: skip
    for value in offsets.values():
        assert len(torch.unique(value.reshape(-1, 3), dim=0)) == value.shape[0] * value.shape[1]
