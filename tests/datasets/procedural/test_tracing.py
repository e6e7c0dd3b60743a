"""Rays against solids whose answers are known in closed form."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.datasets.procedural import ray_images as frames
from splatproof.datasets.procedural import shapes
from splatproof.datasets.procedural.facades import Solid
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.world import Builder
from splatproof.reference.types.camera import project_points

GREY = Solid(tone="808080", dirt=0.0)


def box_on_ground():
    world = Builder()
    world.add(
        "ground", [(shapes.polygon([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]]), GREY)]
    )
    world.add("box", [(shapes.box((4, 4, 3)), GREY)])
    return Caster(world.build())


CASTER = box_on_ground()


class Even:
    """Light from everywhere."""

    def background(self, directions):
        return torch.zeros_like(directions)

    def light(self, points, face_normals, normals):
        return torch.ones_like(normals)


@given(x=st.floats(-20, 20), y=st.floats(-20, 20), z=st.floats(6, 60))
def test_depth_is_that_of_the_planes(x, y, z):
    """z-depth along the ray through each pixel's centre, against the slab test of a box."""
    camera = looking(np.array([x, y, z]), np.array([0.3, -0.2, 0.5]), (24, 16), 25.0)
    depth, normal, objects = frames.truth(CASTER, camera)
    eye = camera.centre.numpy()
    v, u = np.meshgrid(np.arange(16) + 0.5, np.arange(24) + 0.5, indexing="ij")
    ways = (
        np.stack([(u - 12) / 25, (v - 8) / 25, np.ones_like(u)], axis=-1) @ camera.rotation.numpy()
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (np.array([-2, -2, -1]) - eye) / ways
        high = (np.array([2, 2, 3]) - eye) / ways
        enter = np.minimum(low, high).max(axis=-1)
        leave = np.maximum(low, high).min(axis=-1)
        ground = np.where(ways[..., 2] < 0, -eye[2] / ways[..., 2], np.inf)
        reach = eye[:2] + ways[..., :2] * ground[..., None]
    ground = np.where((np.abs(reach) < 50).all(axis=-1), ground, np.inf)
    box = (enter < leave) & (enter > 0) & (enter < ground)
    want = np.where(box, enter, ground)
    edge = np.abs(leave - enter) < 1e-3  # a ray that grazes the box may go either way
    assert (objects[~edge] == np.where(box, 2, np.where(np.isfinite(ground), 1, 0))[~edge]).all()
    np.testing.assert_allclose(depth[~edge], want[~edge], rtol=2e-6)
    assert np.allclose(np.linalg.norm(normal[np.isfinite(depth)], axis=-1), 1, atol=1e-6)
    assert ((normal * ways).sum(axis=-1) <= 0).all()


def test_depth_lifted_to_the_world_projects_back():
    camera = looking(np.array([9.0, -7, 8]), np.zeros(3), (32, 20), 30.0)
    depth, _, _ = frames.truth(CASTER, camera)
    v, u = np.meshgrid(np.arange(20) + 0.5, np.arange(32) + 0.5, indexing="ij")
    origins, ways = frames.pixel_rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    hit = np.isfinite(depth.ravel())
    points = origins[hit] + ways[hit] * depth.ravel()[hit, None]
    pixel, z = project_points(camera, torch.from_numpy(points))
    np.testing.assert_allclose(pixel.numpy(), np.stack([u.ravel(), v.ravel()], 1)[hit], atol=1e-9)
    np.testing.assert_allclose(z.numpy(), depth.ravel()[hit], rtol=1e-9)


def test_visibility():
    points = np.array([[0.0, 5, 0], [0, -5, 0], [0, -2, 1.5]])
    assert CASTER.visible(points, np.array([0.0, -10, 2])).tolist() == [False, True, True]


def test_a_pixel_is_the_mean_over_its_area():
    """Half of the pixel column at the horizon sees ground, half sees black sky."""
    camera = looking(np.array([0.0, -30, 1.0]), np.array([0, -20.0, 1.0]), (8, 9), 6.0)
    frame = frames.take(CASTER, Even(), camera, samples=8, seed=0, seeds=np.zeros(3))
    assert frame.colour[0].max() == 0
    assert (frame.colour[-1] == 0x80).all()
    ends = np.sort(frame.colour[4, :, 0].astype(int))
    # the ground ends 79 m away, a hair under the horizon in the middle of row 4: half the light
    half = 255 * (1.055 * (0.5 * ((0x80 / 255 + 0.055) / 1.055) ** 2.4) ** (1 / 2.4) - 0.055)
    assert abs(ends.mean() - half) < 5


def test_samples_are_the_same_for_a_seed_and_cover_every_stratum():
    draw = [frames.strata(5, 2, 3, 4, np.random.default_rng(7)) for _ in range(2)]
    assert (draw[0] == draw[1]).all()
    cells = np.floor(draw[0] * 4).astype(int)
    assert len(np.unique(cells, axis=0)) == 5 * 3 * 16
    assert cells.min(axis=0).tolist() == [0, 8]


@pytest.mark.parametrize("shape", [shapes.box((2, 3, 4)), shapes.blob((2, 1, 1.5), 0.2, 3),
                                   shapes.cylinder(1.0, 2.0), shapes.gable_roof(6, 4, 3, 2)])  # fmt: skip
def test_shading_normals_look_out_of_the_triangles(shape):
    corner = shape.vertices[shape.faces]
    plane = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    mean = shape.normals[shape.faces].mean(axis=1)
    assert ((plane * mean).sum(axis=1) > 0).all()
    assert np.allclose(np.linalg.norm(shape.normals, axis=1), 1)
