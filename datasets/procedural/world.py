"""A world: triangles with materials and objects, ready to be ray-cast."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from jaxtyping import Float, Int

from splatproof.datasets.procedural.shapes import Shape
from splatproof.datasets.procedural.surface import Material
from splatproof.datasets.procedural.units import Number

Parts = Sequence[tuple[Shape, Material]]


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """Everything that can be seen, at one moment. Gravity is -z, units are metres."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    coords: Float[np.ndarray, "v 4"]
    face_materials: Int[np.ndarray, " f"]
    """Index into `materials`."""
    face_objects: Int[np.ndarray, " f"]
    """Object id, 1 and up; 0 is left for the sky."""
    materials: tuple[Material, ...]
    kinds: tuple[str, ...]
    """What each object is, by object id; kinds[0] is "sky"."""


@dataclass
class Builder:
    """Collects shapes into a world."""

    shapes: list[Shape] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    face_materials: list[Int[np.ndarray, " _"]] = field(default_factory=list)
    face_objects: list[Int[np.ndarray, " _"]] = field(default_factory=list)
    kinds: list[str] = field(default_factory=lambda: ["sky"])

    def add(self, kind: str, parts: Parts) -> int:
        """Add one object.

        Args:
            kind: What it is.
            parts: Its shapes in the world, with their materials.
        Returns: The object's id.
        """
        self.kinds.append(kind)
        self.put(len(self.kinds) - 1, parts)
        return len(self.kinds) - 1

    def later(self, kind: str, make: Callable[[], Parts], x: Number, y: Number) -> int:
        """Add one object whose parts may be made at any time; here at once.

        Args:
            kind: What it is.
            make: Makes its parts.
            x: About where it stands along x, in metres; not needed here.
            y: About where it stands along y, in metres; not needed here.
        Returns: The object's id.
        """
        del x, y
        return self.add(kind, make())

    def put(self, identity: int, parts: Parts) -> None:
        """Add parts of an object that has its id.

        Args:
            identity: The object's id.
            parts: Its shapes in the world, with their materials.
        """
        for shape, material in parts:
            if material not in self.materials:
                self.materials.append(material)
            count = len(shape.faces)
            self.shapes.append(shape)
            self.face_materials.append(np.full(count, self.materials.index(material)))
            self.face_objects.append(np.full(count, identity))

    def copy(self) -> "Builder":
        """Another builder with the same objects so far."""
        return Builder(*(list(getattr(self, f.name)) for f in fields(self)))

    def build(self) -> World:
        """The world of everything added so far."""
        counts = [len(s.vertices) for s in self.shapes]
        starts = np.cumsum([0, *counts[:-1]])
        return World(
            vertices=np.concatenate([s.vertices for s in self.shapes]),
            faces=np.concatenate([s.faces + i for s, i in zip(self.shapes, starts, strict=True)]),
            normals=np.concatenate([s.normals for s in self.shapes]),
            coords=np.concatenate([s.coords for s in self.shapes]),
            face_materials=np.concatenate(self.face_materials),
            face_objects=np.concatenate(self.face_objects),
            materials=tuple(self.materials),
            kinds=tuple(self.kinds),
        )
