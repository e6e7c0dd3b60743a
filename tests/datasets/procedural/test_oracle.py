"""Truth queries on a world small enough to know the answers by heart."""

import numpy as np
import pytest

from splatproof.datasets.procedural import lidar, shapes, traffic
from splatproof.datasets.procedural import oracle as truth
from splatproof.datasets.procedural.facades import Solid
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.world import Builder

GREY = Solid(tone="808080", dirt=0.0)


@pytest.fixture(scope="module")
def caster():
    world = Builder()
    ground = shapes.polygon([[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]])
    world.add("ground", [(ground, GREY)])
    world.add("building", [(shapes.box((4.0, 4.0, 6.0)), GREY)])
    return Caster(world.build())


@pytest.fixture(scope="module")
def cloud(caster):
    return truth.surface_cloud(caster.world, 20.0, 1)


def camera(x, y, z):
    return looking(np.array([x, y, z], dtype=float), np.array([0.0, 0.0, 2.0]), (200, 150), 150.0)


def test_points_lie_on_the_surface_in_proportion_to_area(cloud):
    on_box = cloud.objects == 2
    area = {1: 1600.0, 2: 4 * 24.0 + 16.0}
    for identity, want in area.items():
        count = 20 * want
        assert abs((cloud.objects == identity).sum() - count) < 5 * np.sqrt(count)
    box = cloud.points[on_box]
    outside = np.abs(np.abs(box[:, :2]).max(axis=1) - 2)
    assert np.minimum(outside, np.abs(box[:, 2] - 6)).max() < 1e-12
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1)


def test_a_view_from_one_side_sees_that_side_and_not_the_ground_behind(caster, cloud):
    seen = truth.sightings(caster, cloud, [camera(0, -15, 3)]) > 0
    walls = cloud.objects == 2
    front = walls & (cloud.normals[:, 1] < -0.9) & (cloud.points[:, 2] > 0.1)
    back = walls & (cloud.normals[:, 1] > 0.9)
    assert seen[front].mean() > 0.99
    assert not seen[back].any()
    behind = (cloud.objects == 1) & (np.abs(cloud.points[:, 0]) < 1.5) & (cloud.points[:, 1] > 2)
    assert not seen[behind].any()


def test_blind_facades_are_what_only_the_tests_see(caster, cloud):
    above, side = camera(0.01, 0, 40), camera(0, -15, 3)
    blind = truth.blind_facades(caster, cloud, [above], [side])
    assert len(blind) > 100
    # all of the front, but for the last centimetres before an edge, where sight lines have slack
    assert (blind.normals[:, 1] < -0.9).mean() > 0.99
    assert len(truth.blind_facades(caster, cloud, [above, side], [side])) == 0
    known = truth.visible_surface(caster, cloud, [above, side], least=2)
    assert (known.normals[:, 2] > 0.9).all()


def test_a_sweep_hits_what_is_there_with_range_noise(caster):
    eye = np.array([0.0, -12.0, 2.0])
    sweep = lidar.sweep(caster, eye, 0.0, 360, 5)
    length = np.linalg.norm(sweep.points - eye, axis=1)
    assert abs((length - sweep.ranges).std() - lidar.NOISE) < 0.2 * lidar.NOISE
    true = eye + (sweep.points - eye) / length[:, None] * sweep.ranges[:, None]
    ground, box = sweep.objects == 1, sweep.objects == 2
    assert np.abs(true[ground, 2]).max() < 1e-9
    assert np.abs(np.abs(true[box][:, :2]).max(axis=1) - 2).max() < 1e-9
    assert set(np.unique(sweep.beams)) <= set(range(lidar.BEAMS))
    assert box.sum() > 500


def test_returns_are_lost_at_random_at_range_and_at_grazing_angles():
    rng = np.random.default_rng(0)
    near = lidar._kept(np.full(20_000, 5.0), np.ones(20_000), rng).mean()
    far = lidar._kept(np.full(20_000, 70.0), np.ones(20_000), rng).mean()
    grazing = lidar._kept(np.full(20_000, 5.0), np.full(20_000, 0.01), rng).mean()
    assert abs(near - (1 - lidar.LOST)) < 0.01
    assert far < 0.5
    assert grazing < 0.2


@pytest.mark.parametrize("time", [0.0, 0.3, 1.7])
def test_a_car_moves_as_its_pose_says(time):
    mover = traffic.car("808080", 4.2, traffic.turning(36.0, -12.0, 6.0, 6.5, 1.7))
    own, world = mover.parts(time)[0][0], mover.at(time)[0][0]
    pose = mover.pose(time)
    np.testing.assert_allclose(
        own.vertices @ pose[:3, :3].T + pose[:3, 3], world.vertices, atol=1e-9
    )


def test_a_turning_car_keeps_its_speed_and_heads_where_it_goes():
    place = traffic.turning(36.0, -12.0, 6.0, 6.5, 1.7)
    times = np.linspace(0, 5, 501)
    path = np.array([place(float(t)) for t in times])
    step = np.diff(path[:, :2], axis=0)
    speed = np.linalg.norm(step, axis=1) / np.diff(times)
    np.testing.assert_allclose(speed, 6.0, rtol=1e-3)
    heading = np.arctan2(step[:, 1], step[:, 0])
    gap = np.angle(np.exp(1j * (heading - (path[:-1, 2] + path[1:, 2]) / 2)))
    assert np.abs(gap).max() < 0.01
    assert path[-1, 2] == pytest.approx(np.pi)


def test_a_walker_is_not_rigid():
    walker = traffic.walker(3, 0.0, 0.0, 1.4)
    first, second = (walker.parts(t)[1][0].vertices for t in (0.0, 0.25))
    assert np.abs(first - second).max() > 0.1
    assert walker.kind == "walker"
