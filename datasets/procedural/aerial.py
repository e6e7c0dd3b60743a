"""Small aerial scenes of eight kinds for reconstruction from 3, 5, 7 or 9 views.

In the spirit of LEVIR-NVS and 3DAS: a few oblique views over an arc, and more to test on. Protocols
aerial_sparse_3 to aerial_sparse_9 choose how many of them train.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from threading import Lock

import numpy as np

from splatproof.datasets.procedural import aerial_grounds as grounds
from splatproof.datasets.procedural import aerial_lands as lands
from splatproof.datasets.procedural import city, things
from splatproof.datasets.procedural.blocks import parked_car, tree
from splatproof.datasets.procedural.daylight import Daylight, Sky
from splatproof.datasets.procedural.facades import Facade, Tiles
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.plan import Plan, Shot, Stage, object_seeds
from splatproof.datasets.procedural.shapes import cylinder, joined, placed
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import Builder, World

MARGIN = 215.0
"""Metres of open land around blocks: no view sees its end."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How the scenes are taken."""

    width: int = 208
    height: int = 156
    tests: int = 3
    """Views to test on, between and beyond the training views."""
    cell: float = 3.0
    samples: int = 3


PRESETS = {
    "small": Settings(),
    "medium": Settings(width=512, height=384, tests=8, samples=4),
    "large": Settings(width=1200, height=900, tests=16, cell=2.0, samples=4),
}


def church(seed: int) -> World:
    """A village church with tower and apse among graves and trees."""
    rng = np.random.Generator(np.random.PCG64((seed, 11)))
    world = Builder()
    lands.ground(world, grounds.churchyard)
    stone = Facade(
        tones=("b9ad97", "c7bba3"), storey=8.0, bay=4.2, window=(1.3, 4.5), shutters=False
    )
    slate = Tiles(tones=("565c63",))
    nave = things.house(30.0, 13.0, 9.5, 6.5, stone, slate)[:2]  # without a chimney
    arms = things.house(21.0, 9.0, 8.5, 5.5, stone, slate)[:2]
    transept = things.moved(arms, (6.0, 0.0, 0.0), np.pi / 2)
    tower = things.moved(things.flat_house((8.0, 8.0, 24.0), stone, rng), (-18.0, 0.0, 0.0))[:1]
    spire = placed(cylinder(6.2, 15.0, 4, 0.02), (-18.0, 0.0, 24.0), np.pi / 4)
    apse = placed(cylinder(5.0, 8.0, 16), (15.5, 0.0, 0.0))
    cap = placed(cylinder(5.6, 4.0, 16, 0.02), (15.5, 0.0, 8.0))
    world.add(
        "building", [*nave, *transept, *tower, (spire, slate), (apse, grounds.ashlar), (cap, slate)]
    )
    for x in np.arange(-14, 25, 3.2):
        for y in (-17.0, -21.0, -25.0):
            if rng.random() < 0.8:
                stone_size = (0.9, 0.35, rng.uniform(0.8, 1.4))
                grave = things.box((*stone_size,))
                world.add(
                    "grave", [(placed(grave, (x, y, 0.0), rng.normal(0, 0.1)), grounds.ashlar)]
                )
    angles = 0.5 + 1.2 * np.arange(5)
    homes = 52 * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def taken(x: Number, y: Number) -> bool:
        at_home = np.hypot(*(homes - [x, y]).T).min() < 10
        return bool(at_home) or grounds.near([grounds.LANE, grounds.CHURCH_PATH], x, y, 5.5)

    lands.around(world, rng, 34, 30.0, taken)
    for place, angle in zip(homes, angles, strict=True):
        parts = things.house(11.0, 8.0, 5.6, 3.2, Facade())
        world.add("building", things.moved(parts, (*place, -0.15), angle))
    lands.woods(world, seed, taken=taken)
    return world.build()


def mountain(seed: int) -> World:
    """A rocky summit with a hut, meadows and spruces."""
    rng = np.random.Generator(np.random.PCG64((seed, 12)))
    world = Builder()
    shape = grounds.Mountain(seed)
    lands.ground(world, shape, shape.height, 1.5)
    at = shape.height(np.array([26.0]), np.array([-20.0]))[0]
    world.add("building", things.moved(things.house(8.0, 6.0, 3.0, 2.4, Facade(tones=("8f6f4f",))),
                                       (26.0, -20.0, float(at) - 0.5), 0.6))  # fmt: skip
    places = rng.uniform(-80, 80, (260, 2))
    for (x, y), z in zip(places, shape.height(*places.T), strict=True):
        if z < 15 and rng.random() < 0.85:
            parts = things.conifer(
                rng.uniform(4, 8), rng.uniform(2.4, 3.8), int(rng.integers(1 << 30)), 2
            )
            world.add("tree", things.moved(parts, (x, y, z - 0.3), rng.uniform(0, 6)))
    lands.woods(world, seed, shape.height)
    return world.build()


def stadium(seed: int) -> World:
    """A bowl of stands around a pitch, with light masts and a car park."""
    rng = np.random.Generator(np.random.PCG64((seed, 13)))
    world = Builder()
    lands.ground(world, grounds.stadium, grounds.bowl, 1.0)
    for x in (-44.0, 44.0):
        for y in (-36.0, 36.0):
            mast: things.Parts = [(cylinder(0.5, 26.0, 8, 0.3), things.METAL),
                                  (placed(things.box((4.0, 0.6, 2.4)), (0, 0, 26.0)), things.CONCRETE)]  # fmt: skip
            world.add("mast", things.moved(mast, (x, y, 0.0), np.arctan2(y, x) + np.pi / 2))
    roof = [things.box((52.0, 10.0, 0.7), 15.5)]  # on posts behind the highest row
    roof += [placed(cylinder(0.35, 15.5, 10), (x, 3.6, 0.0)) for x in np.linspace(-24, 24, 7)]
    world.add("stand", things.moved([(joined(*roof), things.CONCRETE)], (0.0, 37.0, 0.0)))
    for x in np.arange(-36, 37, 2.6):
        for y in (-56.0, -66.0):
            if rng.random() < 0.6:
                parked_car(world, x, y, np.pi / 2, rng)
    lands.around(world, rng, 40, 62.0, lambda x, y: -76 < y < -46 and abs(x) < 50, grounds.bowl)
    lands.woods(world, seed, grounds.bowl)
    return world.build()


def factory(seed: int) -> World:
    """Halls with saw-tooth roofs, chimneys, tanks and stacked goods."""
    rng = np.random.Generator(np.random.PCG64((seed, 14)))
    world = Builder()
    lands.ground(world, grounds.yard)
    brick = Facade(tones=("955947", "84523f"), brick=True, storey=4.5, bay=4.0, window=(2.6, 2.2),
                   shutters=False)  # fmt: skip
    for index in range(5):
        tooth = things.house(38.0, 8.0, 7.0, 3.0, brick, Tiles(tones=("74797d",), tile=(1.2, 3.0)))
        world.add("building", things.moved(tooth[:2], (-10.0, -16.0 + 8.0 * index, 0.0)))
    world.add(
        "building",
        things.moved(things.flat_house((16.0, 26.0, 13.0), brick, rng), (24.0, 4.0, 0.0)),
    )
    for x, y in ((20.0, -20.0), (26.0, -22.0)):
        world.add("chimney", [(placed(cylinder(1.7, 34.0, 20, 1.1), (x, y, 0.0)), grounds.banded)])
    for index in range(4):
        tank = cylinder(4.2, 9.0, 28)
        world.add("tank", [(placed(tank, (42.0, -14.0 + 10.0 * index, 0.0)), things.METAL)])
    tones = ("8e4a35", "3e5c73", "7a7d4a", "a8813d", "5a5f66")
    for x in np.arange(-31.0, 16.0, 6.6):
        for y in (-38.0, -35.0, -32.0):
            for level in range(int(rng.choice(3, p=(0.25, 0.45, 0.3)))):
                place = (x + rng.uniform(-0.2, 0.2), y, 2.6 * level)
                paint = grounds.container(str(rng.choice(tones)))
                world.add("container", [(placed(things.box((6.0, 2.4, 2.6)), place), paint)])
    lands.around(world, rng, 40, 60.0, lambda x, y: max(abs(x), abs(y)) < 62)
    lands.woods(world, seed)
    return world.build()


def _blocks(kinds: city.Kinds) -> Callable[[int], World]:
    return lambda seed: city.build(seed, kinds, MARGIN, river=False)


def park(seed: int) -> World:
    """Lawns, paths, trees, a pond and a pavilion."""
    rng = np.random.Generator(np.random.PCG64((seed, 15)))
    world = Builder()
    lands.ground(world, grounds.park, grounds.pond_bed, 2.0)
    sheet = placed(cylinder(13.5, 0.01, 40), (12.0, 6.0, -0.5))
    world.add("water", [(sheet, grounds.water)])
    world.add("building", things.moved(things.house(9.0, 7.0, 3.6, 2.6, Facade(tones=("e3ddd0",))),
                                       (-14.0, -4.0, 0.0), 0.5))  # fmt: skip

    def on_walk(x: Number, y: Number) -> bool:
        return grounds.near(grounds.WALKS, x, y, 4.0)

    for _ in range(100):
        x, y = rng.uniform(-70, 70, 2)
        if np.hypot(x - 12, y - 6) > 18 and np.hypot(x + 14, y + 4) > 9 and not on_walk(x, y):
            tree(world, x, y, rng, float(grounds.pond_bed(np.array([x]), np.array([y]))[0]))
    lands.woods(world, seed, grounds.pond_bed, on_walk)
    return world.build()


SCENES: dict[str, Callable[[int], World]] = {
    "houses": _blocks(((5, 5), (5, 5))),
    "church": church,
    "mountain": mountain,
    "stadium": stadium,
    "town": _blocks(((1, 1), (1, 3))),
    "factory": factory,
    "park": park,
    "downtown": _blocks(((2, 0), (2, 2))),
}


def shots(kind: str, seed: int, settings: Settings) -> list[Shot]:
    """Nine training views over an arc of 100 degrees, and tests between and beyond them.

    Args:
        kind: Name in SCENES.
        seed: Decides where the arc begins and how far each view is off it.
        settings: Size of the pictures and number of test views.
    """
    rng = np.random.Generator(np.random.PCG64((seed, sum(kind.encode()))))
    start = rng.uniform(0, 2 * np.pi)
    size, focal = (settings.width, settings.height), 1.15 * settings.width

    def camera(share: Number, radius: Number, altitude: Number):
        angle = start + np.radians(100) * (share - 0.5)
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), altitude])
        target = np.append(rng.normal(0, 2.0, 2), 4.0)
        return looking(eye + rng.normal(0, 0.5, 3), target, size, focal)

    found = [
        Shot(name=f"train_{index:02d}.png", group=kind,
             camera=camera(index / 8, *((78.0, 72.0), (88.0, 58.0))[index % 2]))
        for index in range(9)
    ]  # fmt: skip
    for index in range(settings.tests):
        share = -0.06 + 1.12 * (index + 0.5) / settings.tests
        view = camera(share, 80.0 + 6 * (index % 2), 66.0 - 8 * (index % 3))
        found.append(Shot(name=f"test_{index:02d}.png", group=kind, camera=view))
    return found


def plan(seed: int, settings: Settings) -> Plan:
    """All eight scenes of a seed, each in a folder of its own.

    Args:
        seed: Another seed makes other scenes of the same kinds; 0 or more.
        settings: How the scenes are taken.
    """
    worlds = {kind: make(seed) for kind, make in SCENES.items()}
    lock, current = Lock(), {}

    def stage(shot: Shot) -> Stage:
        with lock:
            if shot.group not in current:
                current.clear()  # scenes come one after the other
                current[shot.group] = _stage(worlds[shot.group], seed, settings)
            return current[shot.group]

    return Plan(
        world="aerial-sparse", settings=asdict(settings), seed=seed,
        shots=tuple(shot for kind in SCENES for shot in shots(kind, seed, settings)),
        stage=stage, samples=settings.samples, features=500,
        kinds={kind: world.kinds for kind, world in worlds.items()},
    )  # fmt: skip


def _stage(world: World, seed: int, settings: Settings) -> Stage:
    caster = Caster(world)
    light = Daylight(caster, Sky(azimuth=0.4 + seed % 5, elevation=0.85), (-75.0, -75.0, -3.0),
                     (75.0, 75.0, 40.0), settings.cell)  # fmt: skip
    return Stage(caster=caster, lighting=light, object_seeds=object_seeds(len(world.kinds), seed))
