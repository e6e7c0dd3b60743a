"""Blocks of a city: what stands on them and between them."""

import numpy as np

from splatproof.datasets.procedural import things
from splatproof.datasets.procedural.facades import Facade
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import Builder


def _slabs(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """Three long apartment houses with flat roofs."""
    tones = ("d9cfba", "c9b79c", "cfc8be", "b8a68d")
    wall = Facade(tones=tones, storey=2.9, bay=2.9, shutters=False)
    for index in range(3):
        size = (13.0 + rng.uniform(-2, 2), 34.0 + rng.uniform(-3, 1), 2.9 * rng.integers(4, 8))
        place = (centre[0] + (index - 1) * 14.5, centre[1] + rng.uniform(-2, 2), 0.0)
        size = (min(size[0], 10.5), size[1], size[2])
        world.add("building", things.moved(things.flat_house(size, wall, rng), place))
    _scatter_trees(world, centre, rng, 6, 19.0)


def _old_town(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """Small gabled houses wall to wall around a yard."""
    wall = Facade(bay=2.3, storey=2.7)
    for side in range(4):
        heading = side * np.pi / 2
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        u = -19.0
        while u < 10.0:
            length = min(rng.uniform(6.5, 10.5), 10.5 - u) if u < 4 else 10.5 - u
            deep = rng.uniform(8.0, 10.5)
            middle = turn @ np.array([u + length / 2, -19.5 + deep / 2]) + centre
            parts = things.house(
                length, deep, 2.7 * rng.integers(2, 5), rng.uniform(2.5, 4.0), wall
            )
            world.add("building", things.moved(parts, (middle[0], middle[1], 0.0), heading))
            u += length
    _scatter_trees(world, centre, rng, 3, 5.0)


def _offices(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """A tower and a lower wing of glass bands on a plaza."""
    glassy = Facade(tones=("8b939b", "a7a39a", "6f7880"), storey=3.4, bay=2.2, window=(1.9, 2.0),
                    shutters=False)  # fmt: skip
    tall = 3.4 * float(rng.integers(7, 11))
    x, y = centre[0] + rng.uniform(-6, 6), centre[1] + rng.uniform(-4, 4)
    world.add(
        "building", things.moved(things.flat_house((17.0, 15.0, tall), glassy, rng), (x, y, 0.0))
    )
    wing = things.flat_house((12.0, 11.0, 10.2), glassy, rng)
    world.add("building", things.moved(wing, (x + 11.0 * np.sign(-x + centre[0]), y - 11.0, 0.0)))
    _scatter_trees(world, centre, rng, 7, 18.0, keep=12.0)


def _park(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """Trees around a pavilion."""
    pavilion = things.house(6.0, 5.0, 2.8, 1.8, Facade(tones=("e3ddd0",)))
    world.add("building", things.moved(pavilion, (centre[0] - 3, centre[1] + 1, 0.0), 0.4))
    _scatter_trees(world, centre, rng, 26, 19.0, keep=6.0)


def _car_park(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """A supermarket and its cars."""
    hall = things.flat_house((34.0, 14.0, 5.8), Facade(tones=("c3beb4",), storey=5.6, bay=4.5,
                                                      window=(3.2, 2.4), shutters=False), rng)  # fmt: skip
    world.add("building", things.moved(hall, (centre[0], centre[1] + 12.0, 0.0)))
    for x in np.arange(centre[0] - 18, centre[0] + 18, 2.5):
        for y in np.arange(np.floor((centre[1] - 19) / 16) * 16, centre[1] + 3, 16):
            for bay in (2.5, 13.5):
                if rng.random() < 0.55 and centre[1] - 19 < y + bay < centre[1] + 3:
                    parked_car(world, np.ceil(x / 2.5) * 2.5 + 1.25, y + bay, np.pi / 2, rng)


def _villas(world: Builder, centre: np.ndarray, rng: np.random.Generator) -> None:
    """Six houses in gardens with hedges."""
    for column in (-13.0, 0.0, 13.0):
        for row in (-10.0, 10.0):
            parts = things.house(rng.uniform(8, 10.5), rng.uniform(6.5, 8), 2.8 * rng.integers(1, 3) + 0.3,
                                 rng.uniform(2.4, 3.4), Facade(storey=2.8))  # fmt: skip
            heading = rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.05)
            place = (
                centre[0] + column + rng.uniform(-1, 1),
                centre[1] + row + rng.uniform(-1, 1),
                0.0,
            )
            world.add("building", things.moved(parts, place, heading))
        if column < 13:
            _hedge(world, centre[0] + column + 6.5, centre[1], int(rng.integers(1 << 30)))
    _scatter_trees(world, centre, rng, 10, 19.0, keep=3.0)


def _hedge(world: Builder, x: Number, y: Number, seed: int) -> None:
    """A hedge along y."""

    def make() -> things.Parts:
        return things.moved(things.hedge(16.0, 1.1, 1.5, seed), (x, y, 0.0), np.pi / 2)

    world.later("hedge", make, x, y)


BLOCKS = {"slabs": _slabs, "old town": _old_town, "offices": _offices, "park": _park,
          "parking": _car_park, "villas": _villas}  # fmt: skip


def tree(
    world: Builder, x: Number, y: Number, rng: np.random.Generator, z: Number = 0.0, detail: int = 2
) -> None:
    """Add a tree of random kind and size.

    Args:
        world: Gets the tree.
        x: Where it stands along x, in metres.
        y: Where it stands along y, in metres.
        rng: Draws its kind, size and shape.
        z: Height of the ground there, in metres.
        detail: Subdivisions of each lump of leaves, of 20 * 4^detail triangles.
    """
    tall, seed = rng.uniform(5.5, 10.0), int(rng.integers(1 << 30))
    grow = things.conifer if rng.random() < 0.18 else things.tree
    spread, heading = tall * rng.uniform(0.55, 0.8), rng.uniform(0, 6)

    def make() -> things.Parts:
        return things.moved(grow(tall, spread, seed, detail), (x, y, z - 0.1), heading)

    world.later("tree", make, x, y)


def _scatter_trees(
    world: Builder, centre: np.ndarray, rng: np.random.Generator, count: int, reach: Number,
    keep: Number = 0.0,
) -> None:  # fmt: skip
    """Add trees at random places of a block, at least `keep` metres off its centre."""
    for _ in range(count):
        x, y = rng.uniform(-reach, reach, 2)
        if np.hypot(x, y) > keep:
            tree(world, centre[0] + x, centre[1] + y, rng)


def parked_car(
    world: Builder, x: Number, y: Number, heading: Number, rng: np.random.Generator
) -> None:
    """Add a car of random make.

    Args:
        world: Gets the car.
        x: Where it stands along x, in metres.
        y: Where it stands along y, in metres.
        heading: Radians counter-clockwise from +x; the car points that way or the opposite one.
        rng: Draws its make, and which way it points.
    """
    tones = ("c8cbd0", "2b2d31", "7d8187", "9c2f2a", "2f4d77", "e4e4e0", "4f5a49", "b59a5a")
    tone, length = str(rng.choice(tones)), rng.uniform(3.9, 4.7)
    turned = heading + np.pi * rng.integers(0, 2) + rng.normal(0, 0.02)

    def make() -> things.Parts:
        return things.moved(things.car(tone, length), (x, y, 0.0), turned)

    world.later("car", make, x, y)
