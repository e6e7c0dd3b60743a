"""Points from sweeps: the colour of their moment's photo, and which of them moved."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.dynamic.sweep_points import looked_through, timed_points
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, Sweep, View

ORIGIN = torch.zeros(3, dtype=torch.float64)


def wall(distance: float, half: float = 1.0) -> torch.Tensor:
    """A wall across x at a distance, a return every 0.01."""
    side = torch.arange(-half, half, 0.01) * distance
    y, z = torch.meshgrid(side, side, indexing="ij")
    return torch.stack([torch.full_like(y, distance), y, z], dim=-1).reshape(-1, 3)


def sweep(positions: torch.Tensor, origin: torch.Tensor = ORIGIN) -> Sweep:
    return Sweep(positions=positions.float(), origin=origin, time=0.0)


def test_a_place_is_looked_through_where_rays_go_on():
    points = torch.tensor([[5.0, 0, 0], [9.9, 0.3, 0.2], [10.4, 0, 0], [30.0, 0, 0], [-5.0, 0, 0]])
    votes = looked_through(points.double(), [sweep(wall(10.0, 0.3)), sweep(wall(20.0, 0.3))])
    # before both walls; within 3 % of one and before the other; behind one; behind both; unseen
    assert votes.tolist() == [2, 1, 1, 0, 0]


def test_rays_that_go_by_beside_say_nothing():
    hole = wall(10.0, 0.3)
    hole = hole[hole[:, 1:].norm(dim=1) > 0.8]  # nothing came back from the middle
    beside = hole[(hole[:, 1].abs() < 0.02) & (hole[:, 2] > 0)]
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    assert looked_through(
        point, [sweep(hole), sweep(beside), sweep(ORIGIN[None][:0])]
    ).tolist() == [0]


def test_directions_are_those_from_where_the_sensor_was():
    away = torch.tensor([0.0, 100.0, 0.0], dtype=torch.float64)
    point = torch.tensor([[5.0, 0.0, 0.0]]).double()
    there = sweep(wall(10.0, 0.3) + away.float(), away)
    assert looked_through(point, [there]).tolist() == [0]
    assert looked_through(point + away, [there]).tolist() == [1]
    behind = sweep(-wall(10.0, 0.3))  # across the seam of the angle
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
    first = found.take(found.seconds == scene.views[1].time)
    assert first.moved.tolist() == [True, False]
    once = timed_points(drive(at1=torch.cat([thing, behind]), at2=grid))
    assert not once.moved.any()


def test_without_sweeps_there_are_none():
    assert len(timed_points(drive())) == 0
    assert timed_points(tiny_scene()).positions.shape == (0, 3)


@pytest.mark.parametrize("index", [torch.tensor([1]), torch.tensor([False, True])])
def test_some_of_them_are_taken(index):
    found = timed_points(drive(at2=torch.tensor([[0.0, 0.0, 0.0], [0.3, -0.2, 0.5]])))
    assert found.take(index).positions.tolist() == found.positions[1:].tolist()
