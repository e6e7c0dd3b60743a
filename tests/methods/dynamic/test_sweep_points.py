"""Points from sweeps: the colour of their moment's photo, and which of them moved."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.dynamic import sweep_points
from splatproof.methods.dynamic.sweep_motion import in_motion
from splatproof.methods.dynamic.sweep_points import (
    Depths,
    depths,
    looked_through,
    swept_moments,
    timed_points,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, Sweep, View

ORIGIN = torch.zeros(3, dtype=torch.float64)
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def wall(distance: float, half: float = 1.0) -> torch.Tensor:
    """A wall across x at a distance, a return every 0.01."""
    side = torch.arange(-half, half, 0.01) * distance
    y, z = torch.meshgrid(side, side, indexing="ij")
    return torch.stack([torch.full_like(y, distance), y, z], dim=-1).reshape(-1, 3)


def sweep(positions: torch.Tensor, origin: torch.Tensor = ORIGIN) -> Sweep:
    return Sweep(positions=positions.float(), origin=origin, time=0.0)


def looked(positions: torch.Tensor, origin: torch.Tensor = ORIGIN) -> Depths:
    """How far the rays of a sweep went in a world whose z is up."""
    return depths(sweep(positions, origin), UP)


def test_a_place_is_looked_through_where_rays_go_on():
    points = torch.tensor([[5.0, 0, 0], [9.9, 0.3, 0.2], [10.4, 0, 0], [30.0, 0, 0], [-5.0, 0, 0]])
    votes = looked_through(points.double(), [looked(wall(10.0, 0.3)), looked(wall(20.0, 0.3))])
    # before both walls; within 3 % of one and before the other; behind one; behind both; unseen
    assert votes.tolist() == [2, 1, 1, 0, 0]


def test_rays_that_go_by_beside_say_nothing():
    hole = wall(10.0, 0.3)
    hole = hole[hole[:, 1:].norm(dim=1) > 0.8]  # nothing came back from the middle
    beside = hole[(hole[:, 1].abs() < 0.02) & (hole[:, 2] > 0)]
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    blind = [looked(rays) for rays in (hole, beside, ORIGIN[None][:0])]
    assert looked_through(point, blind).tolist() == [0]


def test_directions_below_the_lowest_beam_say_nothing():
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    rays = wall(10.0, 0.3)
    assert looked_through(point, [looked(rays)]).tolist() == [1]
    for side in (1, -1):  # the ring of ground that a sweep hits first goes with the sensor
        one_side = rays[side * rays[:, 2] > 0.05]
        assert looked_through(point, [looked(one_side)]).tolist() == [0]


@pytest.mark.parametrize("turn", ["yzx", "-zx-y", "x-zy", "-yxz"])
def test_another_way_up_changes_nothing(turn):
    """What rays say goes by heights above the ground, whichever axis of the scene is up."""
    named = dict(zip("xyz", torch.eye(3).double(), strict=True))
    rows, sign = [], 1.0
    for letter in turn:
        if letter in named:
            rows.append(sign * named[letter])
        sign = -1.0 if letter == "-" else 1.0
    turned = torch.stack(rows)
    assert torch.linalg.det(turned) == 1
    points = torch.tensor([[5.0, 0, 0], [9.9, 0.3, 0.2], [10.4, 0, 0], [5.0, 1.0, 0.5]]).double()
    rays = wall(10.0, 0.3)
    for part in (rays, rays[rays[:, 2] > 0.05], rays[rays[:, 2] < -0.05], rays[rays[:, 1] > 0.05]):
        upright = looked_through(points, [looked(part)])
        found = depths(sweep(part @ turned.float().T), turned @ UP)
        assert torch.equal(looked_through(points @ turned.T, [found]), upright)


def test_two_rays_are_too_few():
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    rays = torch.tensor([[10.0, 0.0, 0.2], [10.0, 0.0, -0.2]])
    assert looked_through(point, [looked(rays)]).tolist() == [0]


def test_directions_are_those_from_where_the_sensor_was():
    away = torch.tensor([0.0, 100.0, 0.0], dtype=torch.float64)
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    there = looked(wall(10.0, 0.3) + away.float(), away)
    assert looked_through(point, [there]).tolist() == [0]
    assert looked_through(point + away, [there]).tolist() == [1]
    behind = looked(-wall(10.0, 0.3))  # across the seam of the angle
    assert looked_through(-point, [behind]).tolist() == [1]


def drive(**sweeps: torch.Tensor) -> Scene:
    """Views of the tiny scene at 0.0, 0.1, ... s; some with a sweep."""

    def view(index: int, old: View) -> View:
        points = sweeps.get(f"at{index}")
        load = None if points is None else lambda: sweep(points, old.camera.centre)
        return replace(old, time=0.1 * index, load_sweep=load)

    scene = tiny_scene()
    return replace(scene, views=tuple(view(i, v) for i, v in enumerate(scene.views)))


def test_points_have_the_colour_of_the_photo_that_shows_them():
    points = torch.tensor([[0.0, 0.0, 0.0], [0.3, -0.2, 0.5], [0.0, 0.0, -9.0], [50.0, 0.0, 0.0]])
    scene = drive(at2=points, at0=points)  # view 0 is held out
    found = timed_points(scene)
    assert found.positions.tolist() == points[:2].double().tolist()
    assert found.seconds.tolist() == [0.2, 0.2]
    view = scene.views[2]
    pixels, _ = project_points(view.camera, found.positions)
    for (x, y), colour in zip(pixels.tolist(), found.colours, strict=True):
        assert torch.equal(colour, (view.load()[int(y), int(x)] * 255).round().byte())


def test_what_is_behind_another_return_or_masked_is_not_seen():
    where = camera(2)
    point = torch.tensor([0.0, 0.0, 0.0])
    hidden = where.centre.float() + 1.5 * (point - where.centre.float())
    scene = drive(at2=torch.stack([hidden, point]))
    assert timed_points(scene).positions.tolist() == [[0.0, 0.0, 0.0]]
    views = list(scene.views)
    views[2] = replace(views[2], load_mask=lambda: torch.zeros(18, 24, dtype=torch.bool))
    assert len(timed_points(replace(scene, views=tuple(views)))) == 0


def test_what_others_look_through_moved():
    thing, behind = torch.tensor([[0.0, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, 8.0]])
    grid = torch.stack(
        torch.meshgrid(torch.arange(-3, 3, 0.05), torch.arange(-3, 3, 0.05), torch.tensor([8.0]),
                       indexing="ij"), dim=-1
    ).reshape(-1, 3)  # fmt: skip
    scene = drive(at1=torch.cat([thing, behind]), at2=grid, at3=grid)
    found = timed_points(scene)
    time = scene.views[1].time
    assert time is not None
    first = found.take(found.seconds == time)
    assert first.moved.tolist() == [True, False]
    once = timed_points(drive(at1=torch.cat([thing, behind]), at2=grid))
    assert not once.moved.any()


def test_sweeps_nearest_in_time_are_asked_and_each_is_read_once(monkeypatch):
    monkeypatch.setattr(sweep_points, "NEAREST", 2)
    near, read = [], []
    told = sweep_points.depths

    def noted(one: Sweep, up: torch.Tensor) -> sweep_points.Depths:
        read.append(float(one.positions[0, 0]))
        return replace(told(one, up), origin=one.positions[0].double())

    def asked(positions: torch.Tensor, sweeps: list[sweep_points.Depths]) -> torch.Tensor:
        near.append([round(float(one.origin[0]), 3) for one in sweeps])
        return torch.zeros(len(positions), dtype=torch.int64)

    monkeypatch.setattr(sweep_points, "depths", noted)
    monkeypatch.setattr(sweep_points, "looked_through", asked)
    at = {f"at{i}": torch.tensor([[0.001 * i, 0.0, 0.0]]) for i in range(1, 6)}
    timed_points(drive(**at))
    assert near == [[0.002, 0.003], [0.001, 0.003], [0.002, 0.004], [0.003, 0.005], [0.003, 0.004]]
    assert sorted(read) == pytest.approx([0.001 * i for i in range(1, 6)])


def test_some_moments_alone_have_the_returns_that_they_have_among_all():
    at = {f"at{i}": torch.tensor([[0.0, 0.0, 0.0], [0.3, -0.2, 0.1 * i]]) for i in range(1, 6)}
    scene = drive(**at)
    times = swept_moments(scene)
    assert times == [scene.views[i].time for i in scene.train]
    every, some = timed_points(scene), timed_points(scene, times[1:3])
    wanted = every.take((every.seconds == times[1]) | (every.seconds == times[2]))
    for name, value in vars(wanted).items():
        assert torch.equal(value, getattr(some, name)), name
    assert not swept_moments(tiny_scene())


def test_cameras_triggered_one_after_the_other_share_their_sweep_once():
    """Of each sweep three photos, 0.03 s apart; what moves goes 0.3 from one sweep to the next."""
    thing = torch.tensor([[0.05 * i, 0.04 * (i % 3), 0.03 * (i % 2)] for i in range(6)])
    behind = torch.stack(
        torch.meshgrid(torch.arange(-3, 3, 0.05), torch.arange(-3, 3, 0.05), torch.tensor([8.0]),
                       indexing="ij"), dim=-1
    ).reshape(-1, 3)  # fmt: skip
    scene = tiny_scene(views=13)
    where = camera(2)
    views = []
    for index, view in enumerate(scene.views):
        frame, late = divmod(index - 1, 3)
        there = thing + torch.tensor([0.3 * frame - 0.45, 0.0, 0.0])
        load = partial(sweep, torch.cat([there, behind]), where.centre)
        views.append(
            replace(
                view, camera=where, time=0.1 * frame + 0.03 * late, sensor=str(late),
                load_sweep=load, sweep_time=0.1 * frame,
            )
        )  # fmt: skip
    scene = replace(scene, views=tuple(views), train=tuple(range(1, 13)), test=(0,))
    assert swept_moments(scene) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    found = in_motion(timed_points(scene), torch.tensor([0.0, -1.0, 0.0]).double())
    assert found.seconds.unique().tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])
    own = found.take(found.positions[:, 2] < 1)
    assert len(own) > 12
    assert own.moved.all()
    torch.testing.assert_close(
        own.velocities, torch.tensor([[3.0, 0.0, 0.0]]).expand(len(own), 3), atol=0.02, rtol=0
    )


def test_the_photo_nearest_to_the_sweep_gives_the_colour():
    point = torch.tensor([[0.0, 0.0, 0.0]])
    scene = drive(at1=point, at2=point)
    plain = {1: 0.2, 2: 0.8}
    views = [
        replace(view, camera=camera(2), sweep_time=0.19, load=partial(torch.full, view.size + (3,), plain.get(i, 0.0)))
        for i, view in enumerate(scene.views)
    ]  # fmt: skip
    found = timed_points(replace(scene, views=tuple(views)))
    assert found.seconds.tolist() == [0.19]
    assert found.colours.tolist() == [[204, 204, 204]]


def test_without_sweeps_there_are_none():
    assert len(timed_points(drive())) == 0
    assert timed_points(tiny_scene()).positions.shape == (0, 3)


@pytest.mark.parametrize("index", [torch.tensor([1]), torch.tensor([False, True])])
def test_some_of_them_are_taken(index):
    found = timed_points(drive(at2=torch.tensor([[0.0, 0.0, 0.0], [0.3, -0.2, 0.5]])))
    assert found.take(index).positions.tolist() == found.positions[1:].tolist()
