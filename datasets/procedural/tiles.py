"""A world too large for memory: on paper as a whole, built tile by tile where a view looks."""

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.datasets.procedural.daylight import FILLS, Daylight, Sky, sky_moments
from splatproof.datasets.procedural.plan import Shot, Stage
from splatproof.datasets.procedural.shapes import Shape
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number, Pair
from splatproof.datasets.procedural.world import Builder, Parts, World
from splatproof.reference.types.camera import Camera

Tile = tuple[int, int]

SPILL = 20.0
"""Metres by which an object may stand out of its tile."""
SHADE = 30.0
"""Metres beyond which nothing throws a shadow: 37 m of height under a sun 0.9 rad high."""
HEIGHTS = (-5.0, 60.0)
"""Metres between which everything stands."""
STAGES = 2
"""Lit views kept: one for each worker."""


class Sketch(Builder):
    """A builder that notes objects by tile; their triangles are made when a tile is built."""

    def __init__(self, size: Number, origin: Pair):
        """Start with nothing noted.

        Args:
            size: Side of the square tiles, in metres.
            origin: Low corner (x, y) of tile (0, 0), in metres.
        """
        super().__init__()
        self.size, self.origin = float(size), np.array(origin, dtype=float)
        self.notes: dict[Tile, list[tuple[int, Callable[[], Parts]]]] = defaultdict(list)
        self.wide: list[tuple[int, Parts]] = []
        """What no tile can hold: triangles larger than a tile."""

    def add(self, kind: str, parts: Parts) -> int:
        """Note an object; one wider than a tile is cut along its triangles.

        Args:
            kind: What the object is.
            parts: Its shapes in the world, with their materials.
        Returns: The object's id.
        """
        points = np.concatenate([shape.vertices[:, :2] for shape, _ in parts])
        low, high = points.min(axis=0), points.max(axis=0)
        if (high - low).max() <= self.size:
            return self.later(kind, lambda: parts, *((low + high) / 2))
        self.kinds.append(kind)
        for shape, material in parts:
            corner = shape.vertices[shape.faces][..., :2]
            large = (np.ptp(corner, axis=1) > self.size).any(axis=1)
            cells = self._cells(corner.mean(axis=1))
            if large.any():
                self.wide.append((len(self.kinds) - 1, [(_some(shape, large), material)]))
            for cell in np.unique(cells[~large], axis=0):
                piece = [(_some(shape, (cells == cell).all(axis=1) & ~large), material)]
                self._note((int(cell[0]), int(cell[1])), lambda piece=piece: piece)
        return len(self.kinds) - 1

    def later(self, kind: str, make: Callable[[], Parts], x: Number, y: Number) -> int:
        """Note an object that stands around (x, y).

        Args:
            kind: What the object is.
            make: Makes its parts; called each time its tile is built.
            x: About where it stands along x, in metres; with `y` it decides the tile.
            y: About where it stands along y, in metres.
        Returns: The object's id.
        """
        self.kinds.append(kind)
        cell = self._cells(np.array([x, y], dtype=float))
        self._note((int(cell[0]), int(cell[1])), make)
        return len(self.kinds) - 1

    def _note(self, tile: Tile, make: Callable[[], Parts]) -> None:
        self.notes[tile].append((len(self.kinds) - 1, make))

    def _cells(self, points: Float[np.ndarray, "*n 2"]) -> Int[np.ndarray, "*n 2"]:
        return np.floor((points - self.origin) / self.size).astype(int)

    def tile(self, tile: Tile) -> World:
        """The triangles of one tile."""
        return self._built(self.notes[tile])

    def everywhere(self) -> World:
        """The triangles that belong to every tile."""
        return self._built([(identity, lambda p=parts: p) for identity, parts in self.wide])

    def _built(self, notes: Sequence[tuple[int, Callable[[], Parts]]]) -> World:
        # one list of materials for all tiles, so that their indices agree
        builder = Builder(materials=self.materials, kinds=self.kinds)
        for identity, make in notes:
            builder.put(identity, make())
        return builder.build()


def _some(shape: Shape, rows: Bool[np.ndarray, " f"]) -> Shape:
    """The shape's triangles in these rows."""
    used, faces = np.unique(shape.faces[rows], return_inverse=True)
    return Shape(
        vertices=shape.vertices[used], faces=faces.reshape(-1, 3), normals=shape.normals[used],
        coords=shape.coords[used],
    )  # fmt: skip


class TileCache:
    """The tiles built last."""

    def __init__(self, sketch: Sketch, keep: int):
        """Start with no tile built.

        Args:
            sketch: What the tiles hold.
            keep: Number of tiles kept between calls, at most.
        """
        self.sketch, self.keep = sketch, keep
        self._built: OrderedDict[Tile, World] = OrderedDict()
        self._wide = [sketch.everywhere()] if sketch.wide else []

    def world(self, tiles: Sequence[Tile]) -> World:
        """All triangles of some tiles."""
        worlds = list(self._wide)
        for tile in tiles:
            if tile not in self._built:
                self._built[tile] = self.sketch.tile(tile)
            self._built.move_to_end(tile)
            worlds.append(self._built[tile])
            while len(self._built) > self.keep:
                self._built.popitem(last=False)
        starts = np.cumsum([0, *(len(world.vertices) for world in worlds[:-1])])
        return replace(
            worlds[0],
            vertices=np.concatenate([world.vertices for world in worlds]),
            faces=np.concatenate([w.faces + i for w, i in zip(worlds, starts, strict=True)]),
            normals=np.concatenate([world.normals for world in worlds]),
            coords=np.concatenate([world.coords for world in worlds]),
            face_materials=np.concatenate([world.face_materials for world in worlds]),
            face_objects=np.concatenate([world.face_objects for world in worlds]),
            materials=tuple(self.sketch.materials), kinds=tuple(self.sketch.kinds),
        )  # fmt: skip


def looked_at(sketch: Sketch, camera: Camera, margin: Number) -> tuple[Tile, ...]:
    """Tiles that a view may see, and those that may stand or throw shadows into what it sees.

    A tile is left out if its box lies outside of one side of the view.

    Args:
        sketch: What the tiles hold.
        camera: Camera of the view.
        margin: Metres by which a tile's box is widened on each side for these others.
    """
    tiles = np.array(sorted(tile for tile, notes in sketch.notes.items() if notes))
    low = sketch.origin + tiles * sketch.size - margin
    high = low + sketch.size + 2 * margin
    sides = (np.stack([low, high])[:, :, axis] for axis in range(2))
    x, y = ([side[0], side[1]] for side in sides)
    corners = np.stack(
        [np.stack([a, b, np.full(len(tiles), z)], axis=1) for a in x for b in y for z in HEIGHTS],
        axis=1,
    )
    local = corners @ camera.rotation.numpy().T + camera.translation.numpy()
    u, v, depth = np.moveaxis(local @ camera.K.numpy().T, 2, 0)
    inside = (depth, u, camera.width * depth - u, v, camera.height * depth - v)
    seen = np.all([(side > 0).any(axis=1) for side in inside], axis=0)
    return tuple((int(a), int(b)) for a, b in tiles[seen])


class TiledStage:
    """The lit world of a shot, of the tiles that it looks at; called from several threads.

    Sky light is known on one grid over all tiles. A tile's part depends on the tiles around it
    alone, so every view that sees a place sees it under the same light.
    """

    def __init__(self, sketch: Sketch, sky: Sky, heights: Pair, cell: Number,
                 object_seeds: Float[np.ndarray, " objects"], keep: int):  # fmt: skip
        """Start with nothing built.

        Args:
            sketch: What the tiles hold.
            sky: Where the sun stands and how bright things are.
            heights: Lowest and highest place at which sky light is known, in metres.
            cell: Metres between the places where it is known, about.
            object_seeds: A number in [0, 1) for each object id, for textures.
            keep: Number of tiles kept between views, at most.
        """
        self.sketch, self.sky, self.object_seeds = sketch, sky, object_seeds
        self.cache = TileCache(sketch, keep)
        self.count = int(np.ceil(sketch.size / cell))
        """Cells along a side of a tile."""
        self.cell = sketch.size / self.count
        self.levels = np.linspace(*heights, max(2, int(np.ceil((heights[1] - heights[0]) / cell))))
        self._lock = Lock()
        self._stages: OrderedDict[tuple[Tile, ...], Stage] = OrderedDict()
        self._light: dict[Tile, Tensor] = {}

    def __call__(self, shot: Shot) -> Stage:
        """Build what the shot looks at, or find it."""
        tiles = looked_at(self.sketch, shot.camera, SPILL + SHADE)
        with self._lock:
            if tiles not in self._stages:
                while len(self._stages) >= STAGES:
                    self._stages.popitem(last=False)
                self._stages[tiles] = self._stage(tiles)
            self._stages.move_to_end(tiles)
            return self._stages[tiles]

    def _stage(self, tiles: tuple[Tile, ...]) -> Stage:
        first, last = np.min(tiles, axis=0), np.max(tiles, axis=0)
        shape = (last - first + 1) * self.count
        volume = torch.zeros(1, 12, int(shape[0]), int(shape[1]), len(self.levels))
        for tile in tiles:
            i, j = ((np.array(tile) - first) * self.count).tolist()
            volume[:, :, i : i + self.count, j : j + self.count] = self._tile_light(tile)
        low = self.sketch.origin + first * self.sketch.size
        high = low + (shape - 1) * self.cell
        caster = Caster(self.cache.world(tiles))
        light = Daylight.known(
            caster, self.sky, np.append(low, self.levels[0]), np.append(high, self.levels[-1]),
            self.cell, volume,
        )  # fmt: skip
        return Stage(caster=caster, lighting=light, object_seeds=self.object_seeds)

    def _tile_light(self, tile: Tile) -> Float[Tensor, "1 12 n n z"]:
        """Sky light in a tile's cells, among the tiles that touch it."""
        if tile not in self._light:
            around = [(tile[0] + i, tile[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            caster = Caster(self.cache.world([t for t in around if self.sketch.notes.get(t)]))
            steps = np.arange(-FILLS, self.count + FILLS) * self.cell
            x, y = (self.sketch.origin[k] + tile[k] * self.sketch.size + steps for k in (0, 1))
            places = np.stack(np.meshgrid(x, y, self.levels, indexing="ij"), axis=-1)
            found = sky_moments(caster, self.sky, places)
            self._light[tile] = found[:, :, FILLS:-FILLS, FILLS:-FILLS].clone()
        return self._light[tile]
