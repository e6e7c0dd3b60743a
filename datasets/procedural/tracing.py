"""Rays against a world's triangles: Embree finds the triangle, float64 finds the point."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from splatproof.datasets.procedural.embree_device import narrow_device
from splatproof.datasets.procedural.world import World

START = 1e-3
"""Metres by which rays from a surface start off it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """What rays met first. Rows where `face` is -1 met nothing."""

    face: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    """Distances in lengths of the ray's direction; inf where nothing was met."""


class Caster:
    """The world in Embree's tree, with the planes that make hits exact."""

    def __init__(self, world: World):
        """Build the tree."""
        self.world = world
        corner = world.vertices[world.faces]
        self.origin = corner[:, 0]
        edge1, edge2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
        self.plane = np.cross(edge1, edge2)
        """Face normals times twice the area."""
        area = (self.plane**2).sum(axis=1, keepdims=True).clip(1e-24)
        self.dual = (np.cross(edge2, self.plane) / area, np.cross(self.plane, edge1) / area)
        self.face_normals = self.plane / np.sqrt(area)
        self._scene = EmbreeScene(device=narrow_device())
        TriangleMesh(self._scene, world.vertices.astype(np.float32), world.faces.astype(np.int32))

    def first(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Hits:
        """The first triangle on each ray; its distance is that of the ray and the plane.

        Args:
            origins: Where the rays begin, in metres.
            directions: Where they go; of any length.
        """
        face = self._scene.run(
            origins.astype(np.float32), directions.astype(np.float32), query="INTERSECT"
        ).astype(np.int64)
        plane = self.plane[face]
        along = np.einsum("ij,ij->i", directions, plane)
        gap = np.einsum("ij,ij->i", self.origin[face] - origins, plane)
        missed = (face < 0) | (along == 0)
        distance = np.where(missed, np.inf, gap / np.where(along == 0, 1, along))
        return Hits(face=np.where(missed, -1, face), distance=distance)

    def blocked(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"] | None = None,
    ) -> Bool[np.ndarray, " n"]:
        """Whether anything lies on each ray.

        Args:
            origins: Where the rays begin, in metres.
            directions: Where they go; of any length.
            reach: How far to look, in lengths of the direction; None: without end.
        """
        starts, ways = origins.astype(np.float32), directions.astype(np.float32)
        if reach is None:
            return self._scene.run(starts, ways, query="OCCLUDED") == 0
        return self._scene.run(starts, ways, query="DISTANCE") < reach

    def weights(
        self, face: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Barycentric weights of points on faces.

        Args:
            face: Index of each point's triangle.
            points: Places on these triangles, in metres.
        """
        offset = points - self.origin[face]
        b1 = np.einsum("ij,ij->i", offset, self.dual[0][face])
        b2 = np.einsum("ij,ij->i", offset, self.dual[1][face])
        return np.stack([1 - b1 - b2, b1, b2], axis=1)

    def visible(
        self, points: Float[np.ndarray, "n 3"], eye: Float[np.ndarray, "3"], slack: float = 0.02
    ) -> Bool[np.ndarray, " n"]:
        """Whether nothing stands between an eye and each point.

        Args:
            points: Places in metres, none of them the eye's.
            eye: Where is looked from, in metres.
            slack: Metres before each point in which nothing counts: its own surface lies there.
        """
        ways = points - eye
        length = np.linalg.norm(ways, axis=1)
        starts = np.broadcast_to(eye, points.shape)
        return ~self.blocked(starts, ways / length[:, None], length - slack)
