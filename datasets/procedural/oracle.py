"""Questions to a made world that photos cannot answer: its true surface, and who saw which part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import World
from splatproof.reference.types.camera import Camera

UPRIGHT = 0.3
"""Largest |z| of the unit normal of a facade."""
STEEP = 0.15
"""Cosine between view and surface below which a view tells nothing of the surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """Points on true surfaces."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit geometric normals, outwards as the triangles are wound."""
    objects: Int[np.ndarray, " n"]
    """Object ids."""

    def part(self, rows: Bool[np.ndarray, " n"]) -> "Cloud":
        """The points in the given rows."""
        return Cloud(
            points=self.points[rows], normals=self.normals[rows], objects=self.objects[rows]
        )

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)


def surface_cloud(world: World, per_square_metre: Number, seed: int) -> Cloud:
    """Points spread evenly over all triangles, seen or not.

    Args:
        world: The world.
        per_square_metre: Mean density.
        seed: Decides the places.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 61)))
    corner = world.vertices[world.faces]
    plane = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    double = np.linalg.norm(plane, axis=1)
    count = rng.poisson(0.5 * double.sum() * per_square_metre)
    face = rng.choice(len(double), count, p=double / double.sum())
    a, b = rng.random((2, count, 1))
    fold = a + b > 1
    a, b = np.where(fold, 1 - a, a), np.where(fold, 1 - b, b)
    start, first, second = corner[face].transpose(1, 0, 2)
    return Cloud(
        points=start + a * (first - start) + b * (second - start),
        normals=plane[face] / double[face, None],
        objects=world.face_objects[face],
    )


def sightings(caster: Caster, cloud: Cloud, cameras: Sequence[Camera]) -> Int[np.ndarray, " n"]:
    """How many cameras see each point: in the image, nothing before it, not too steeply.

    Both sides of a triangle count as surface, since thin things have no inside.

    Args:
        caster: The world, which hides points from cameras.
        cloud: The points.
        cameras: Pinhole cameras in the world's frame.
    """
    count = np.zeros(len(cloud), dtype=np.int64)
    for camera in cameras:
        local = cloud.points @ camera.rotation.numpy().T + camera.translation.numpy()
        ahead = local[:, 2] > camera.near
        pixel = local @ camera.K.numpy().T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = pixel[:, :2] / pixel[:, 2:]
        size = np.array([camera.width, camera.height])
        rows = np.flatnonzero(ahead & ((pixel >= 0) & (pixel < size)).all(axis=1))
        eye = camera.centre.numpy()
        ways = eye - cloud.points[rows]
        cosine = np.einsum("ij,ij->i", ways, cloud.normals[rows]) / np.linalg.norm(ways, axis=1)
        rows = rows[np.abs(cosine) > STEEP]
        count[rows] += caster.visible(cloud.points[rows], eye)
    return count


def visible_surface(
    caster: Caster, cloud: Cloud, cameras: Sequence[Camera], least: int = 1
) -> Cloud:
    """The part of the surface that enough cameras see: what a method can know.

    Args:
        caster: The world, which hides points from cameras.
        cloud: Points on its surface.
        cameras: Pinhole cameras in the world's frame.
        least: Number of cameras that must see a point.
    """
    return cloud.part(sightings(caster, cloud, cameras) >= least)


def _facades(world: World, cloud: Cloud) -> Cloud:
    """The upright part of buildings."""
    building = np.array([kind in ("building", "house", "barn") for kind in world.kinds])
    return cloud.part(building[cloud.objects] & (np.abs(cloud.normals[:, 2]) < UPRIGHT))


def blind_facades(
    caster: Caster, cloud: Cloud, training: Sequence[Camera], tests: Sequence[Camera]
) -> Cloud:
    """Facades that a test view sees and no training view did: the blind spots of a flight.

    Args:
        caster: The world, which hides points from cameras.
        cloud: Points on its surface.
        training: Cameras of the training views.
        tests: Cameras of the test views.
    """
    walls = _facades(caster.world, cloud)
    walls = walls.part(sightings(caster, walls, tests) > 0)
    return walls.part(sightings(caster, walls, training) == 0)
