"""Truth queries of whole worlds against triangles in float64, and motion against the depth maps."""

import numpy as np
import pycolmap
import pytest

from helpers import brute_rays, tiny_worlds
from splatproof.datasets.procedural import exporting, shapes
from splatproof.datasets.procedural import oracle as truth
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.things import METAL
from splatproof.datasets.procedural.world import Builder

SAMPLE = 12
"""Points of each kind that are looked at from every camera."""


def stage_of(world):
    """A tiny world's rays, training cameras and test cameras."""
    plan = tiny_worlds.plan(world)
    shots = plan.shots
    if world == "aerial-sparse":  # seen from one end of the arc, tested from the other
        church = {shot.name: shot for shot in shots if shot.group == "church"}
        shots = list(church.values())
        training, tests = (
            [church[f"train_{place:02d}.png"].camera for place in places]
            for places in ((0, 1), (7, 8))
        )
    else:
        training = [shot.camera for shot in shots if not shot.group]
        tests = [shot.camera for shot in shots if shot.group]
    return plan.stage(shots[0]).caster, training, tests


def sample(cloud, seed):
    """A few of a cloud's points."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(len(cloud), dtype=bool)
    rows[rng.choice(len(cloud), min(SAMPLE, len(cloud)), replace=False)] = True
    return cloud.part(rows)


@pytest.mark.parametrize(
    ("world", "density"),
    [
        pytest.param("city", 1.0, marks=pytest.mark.slow),
        ("tunnel", 20.0),
        pytest.param("street", 1.0, marks=pytest.mark.slow),
    ],
)
def test_what_is_visible_is_what_triangles_say(world, density):
    caster, training, _ = stage_of(world)
    training = training[::3]
    cloud = truth.surface_cloud(caster.world, density, 0)
    counts = truth.sightings(caster, cloud, training)
    for rows in (counts == 0, counts > 0):
        some = sample(cloud.part(rows), 1)
        found = [brute_rays.views_of(caster.world, p, n, training, truth.STEEP).sum()
                 for p, n in zip(some.points, some.normals, strict=True)]  # fmt: skip
        told = truth.sightings(caster, some, training)
        # float32 rays may slip past the rim of a triangle: one sight line in a hundred
        assert np.abs(told - np.array(found)).sum() <= 0.01 * max(told.sum(), 100)
    assert len(truth.visible_surface(caster, cloud, training)) == (counts > 0).sum()


@pytest.mark.parametrize(
    ("world", "density"),
    [
        pytest.param("city", 2.0, marks=pytest.mark.slow),
        pytest.param("aerial-sparse", 2.0, marks=pytest.mark.slow),
    ],
)
def test_blind_facades_are_hidden_from_every_training_view(world, density):
    caster, training, tests = stage_of(world)
    cloud = truth.surface_cloud(caster.world, density, 0)
    blind = truth.blind_facades(caster, cloud, training, tests)
    assert len(blind) > 50
    some = sample(blind, 2)
    for point, normal in zip(some.points, some.normals, strict=True):
        assert not brute_rays.views_of(caster.world, point, normal, training, truth.STEEP).any()
        assert brute_rays.views_of(caster.world, point, normal, tests, truth.STEEP).any()
        assert abs(normal[2]) < truth.UPRIGHT
    # exact rays to all of them: whatever they meet lies before the point
    for camera in training:
        eye = np.broadcast_to(camera.centre.numpy(), blind.points.shape)
        met = caster.first(eye, blind.points - eye).distance
        local = blind.points @ camera.rotation.numpy().T + camera.translation.numpy()
        pixel = local @ camera.K.numpy().T
        pixel = pixel[:, :2] / pixel[:, 2:]
        inside = ((pixel > 0) & (pixel < [camera.width, camera.height])).all(axis=1)
        ways = (eye - blind.points) / np.linalg.norm(eye - blind.points, axis=1)[:, None]
        known = inside & (np.abs((ways * blind.normals).sum(axis=1)) > truth.STEEP)
        assert (met[known] < 1 - 1e-6).all()


def test_the_oracle_sees_past_nothing():
    world = Builder()
    world.add("wall", [(shapes.box((2.0, 0.2, 2.0)), METAL)])
    world = world.build()
    camera = looking(np.array([0.0, -5.0, 1.0]), np.array([0.0, 0.0, 1.0]), (64, 64), 64.0)
    front, back, up = np.array([0, -0.1, 1.0]), np.array([0, 0.1, 1.0]), np.array([0, 1.0, 0])
    assert brute_rays.views_of(world, front, up, [camera], 0.15).tolist() == [True]
    assert brute_rays.views_of(world, back, up, [camera], 0.15).tolist() == [False]
    assert brute_rays.views_of(world, np.array([9.0, 0, 1]), up, [camera], 0.15).tolist() == [False]
    assert brute_rays.views_of(world, front, np.array([1.0, 0, 0]), [camera], 0.15).tolist() == [
        False
    ]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_files_alone_tell_how_cars_move(tmp_path, made, seed):
    """Points of a car, taken from one frame's depth, lie on it in the next after its motion."""
    if seed == 1:
        folder, _ = made("street")
    else:
        folder = exporting.make_scene(tiny_worlds.plan("street", seed), tmp_path / "street")
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    images = {image.name: image for image in model.images.values()}
    with np.load(folder / "motion.npz") as motion:
        objects, poses, rigid = (motion[key] for key in ("objects", "poses", "rigid"))
    gaps, stuck = [], []
    for frame in range(len(poses) - 1):
        for camera in ("front", "left", "right"):
            now, then = (f"frame_{frame + k:04d}_{camera}.png" for k in (0, 1))
            one, two = (exporting.read_frame(folder, name) for name in (now, then))
            for index in np.flatnonzero(rigid):
                points = lifted(images[now], model, one.depth, one.object == objects[index])
                moved = poses[frame + 1, index] @ np.linalg.inv(poses[frame, index])
                gaps += gap_to(images[then], model, two, objects[index], points, moved)
                stuck += gap_to(images[then], model, two, objects[index], points, np.eye(4))
    assert len(gaps) > 50
    # through pixel centres: a car's side slants by less than 0.3 metres a pixel at this size
    assert np.median(np.abs(gaps)) < 0.05
    assert np.median(np.abs(stuck)) > 3 * np.median(np.abs(gaps))


def lifted(image, model, depth, rows):
    """World points of some pixels."""
    pose = image.cam_from_world().matrix()
    fx, fy, cx, cy = model.cameras[image.camera_id].params
    y, x = np.nonzero(rows)
    z = depth[y, x].astype(float)
    local = np.stack([(x + 0.5 - cx) / fx * z, (y + 0.5 - cy) / fy * z, z], axis=1)
    return (local - pose[:, 3]) @ pose[:, :3]


def gap_to(image, model, frame, identity, points, moved):
    """Metres along z from moved points to the surface of an object where a view shows it."""
    points = points @ moved[:3, :3].T + moved[:3, 3]
    pose = image.cam_from_world().matrix()
    fx, fy, cx, cy = model.cameras[image.camera_id].params
    x, y, z = (points @ pose[:, :3].T + pose[:, 3]).T
    u, v = np.floor(fx * x / z + cx).astype(int), np.floor(fy * y / z + cy).astype(int)
    height, width = frame.depth.shape
    inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, z = u[inside], v[inside], z[inside]
    same = frame.object[v, u] == identity
    return (z - frame.depth[v, u])[same].tolist()
