"""The small scene of the quick suite: a farm around a courtyard, seen from a low flight."""

from dataclasses import asdict, dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural import things
from splatproof.datasets.procedural.daylight import Daylight, Sky
from splatproof.datasets.procedural.facades import Facade, Planks, Tiles, stone_wall
from splatproof.datasets.procedural.flights import looking, ring, strips
from splatproof.datasets.procedural.grounds import (
    asphalt_colour,
    grass_colour,
    gravel_colour,
    paving_colour,
    plain,
    segment_distance,
    soil_colour,
    water,
)
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.plan import Plan, Shot, Stage, object_seeds, once
from splatproof.datasets.procedural.shapes import box, cylinder, heightfield, joined, placed
from splatproof.datasets.procedural.surface import Paint, Surface, layered, step
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.world import Builder, World
from splatproof.reference.types.camera import Camera

ROAD = [(-60.0, -21.0), (-20.0, -19.0), (0.0, -19.5), (25.0, -23.0), (60.0, -22.0)]
PATH = [(0.0, -19.5), (0.5, -12.0), (-1.0, -4.0), (-3.0, 3.0)]
YARD = (10.5, 9.5)
"""Half-sizes of the walled yard in metres."""
POND = (17.0, 12.5, 3.6)
"""Centre and radius of the pond."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How large the scene is taken."""

    width: int = 240
    height: int = 176
    oblique: int = 10
    """Views on each of two rings."""
    nadir: tuple[int, int] = (4, 2)
    """Stations along and across the nadir lines."""
    samples: int = 3
    """Strata a pixel on each axis."""


PRESETS = {
    "small": Settings(),
    "medium": Settings(width=480, height=352, oblique=20, nadir=(5, 4), samples=4),
    "large": Settings(width=1200, height=880, oblique=40, nadir=(8, 8), samples=4),
}


def ground(surface: Surface) -> Paint:
    """Yard of gravel and slabs, a path, a road, grass and a field."""
    p = surface.points[:, :2]
    edge = 1.2 * (fbm(p, 2.2, 4, 201) - 0.5)
    inside = (p.abs() / p.new_tensor(YARD)).amax(dim=1)
    yard = step(1.0, 0.9, inside + 0.12 * edge)
    path, _ = segment_distance(p, PATH)
    terrace = ((p - p.new_tensor([-3.0, 4.2])).abs() / p.new_tensor([5.5, 1.9])).amax(dim=1)
    road, along = segment_distance(p, ROAD)
    dash = (road < 0.09) & (torch.remainder(along / 3.0, 1) < 0.55)
    bank = (p - p.new_tensor(POND[:2])).norm(dim=1) - POND[2]
    return Paint(
        albedo=layered(
            surface,
            [
                (None, grass_colour),
                (step(16.6, 17.2, p[:, 1] - 0.15 * p[:, 0] + edge), soil_colour),
                (yard, gravel_colour),
                (yard * step(0.60, 0.68, fbm(p, 5.0, 4, 202)), grass_colour),
                (step(1.9, 1.4, path + edge), gravel_colour),
                (step(1.02, 1.0, path + 0.15 * edge), paving_colour),
                (step(1.0, 0.99, terrace), terrace_colour),
                (step(3.7, 3.1, road + edge), gravel_colour),
                (step(2.9, 2.8, road + 0.2 * edge), asphalt_colour),
                (0.85 * dash.float(), plain("cfccc2")),
                (step(1.2, 0.2, bank + edge), plain("6b5d45")),
            ],
        )
    )


def terrace_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Large slabs before the house."""
    return paving_colour(surface, (1.1, 0.8), "b0a08a")


Height = Float[np.ndarray, "..."] | float


def height(x: Height, y: Height) -> Height:
    """Height of gently rolling ground, flat in the yard and dug out at the pond, in metres.

    Args:
        x: Places in metres.
        y: Places in metres, one for each of `x`.
    """
    hills = 1.6 * np.sin(0.055 * x + 0.6) * np.cos(0.06 * y) + 0.6 * np.sin(0.13 * x - 0.11 * y)
    shore = np.hypot(x - POND[0], y - POND[1]) - POND[2]
    far = np.clip((np.hypot(x, y) - 15) / 25, 0, 1) * np.clip(shore / 8, 0, 1)
    return hills * far + 0.6 * np.clip(shore / 1.4, -1, 0)


def build(seed: int) -> World:
    """The farm of one seed: the plan stands, trees, tones and small things change."""
    rng = np.random.Generator(np.random.PCG64(seed))
    world = Builder()
    xs = np.concatenate([np.arange(-120, -26, 4), np.arange(-26, 26, 0.5), np.arange(26, 121, 4)])
    world.add("ground", [(heightfield(xs, xs, np.asarray(height(*np.meshgrid(xs, xs)))), ground)])
    sheet = placed(cylinder(POND[2] * 1.02, 0.01, 32), (POND[0], POND[1], -0.22))
    world.add("water", [(sheet, water)])
    _buildings(world)
    _walls(world)
    _trees(world, rng)
    for x, y, heading, tone in ((5.6, -5.2, 1.9, "9c2f2a"), (8.0, -20.6, -0.12, "c9ccd0"),
                                (-14.0, -18.6, 3.19, "2f4d77")):  # fmt: skip
        world.add("car", things.moved(things.car(tone), (x, y, float(height(x, y))), heading))
    for index in range(5):
        bale = cylinder(0.75, 1.3, 16)
        x, y = 13.5 + 1.9 * (index % 3), -8.0 + 2.0 * (index // 3)
        world.add("bale", [(placed(bale, (x, y, 0.0)), Planks(tone="c2a45c"))])
    return world.build()


def _buildings(world: Builder) -> None:
    """House with a wing, barn, shed and well."""
    plaster = Facade(tones=("ddd0b4",))
    house = things.moved(things.house(13.0, 7.0, 5.6, 3.4, plaster), (-3.0, 9.6, 0.0))
    wing = things.moved(things.house(7.5, 5.2, 2.9, 2.3, plaster), (-9.2, 3.9, 0.0), np.pi / 2)
    dormers = [
        things.moved(things.dormer(1.6, 2.0, 1.3, plaster), (x, 6.6, 6.0)) for x in (-5.6, -0.6)
    ]
    world.add("house", house + wing + dormers[0] + dormers[1])
    brick = Facade(tones=("9c5b45",), brick=True, shutters=False, bay=3.4, window=(0.9, 1.0))
    slate = Tiles(tones=("62656b",), tile=(0.5, 0.45))
    world.add(
        "barn",
        things.moved(things.house(11.0, 6.4, 3.9, 3.2, brick, slate), (8.6, 3.0, 0.0), np.pi / 2),
    )
    world.add(
        "shed", things.moved(things.house(4.6, 3.4, 2.4, 1.3, Planks()), (-8.3, -6.7, 0.0), 0.15)
    )
    ring_of_stones = cylinder(0.9, 0.9, 16)
    roof = things.gable_roof(2.0, 1.8, 2.3, 0.8, 0.3)
    posts = joined(*(placed(box((0.16, 0.16, 2.4)), (x, 0, 0)) for x in (-0.8, 0.8)))
    world.add("well", things.moved([(ring_of_stones, Planks(tone="9a9082")), (posts, Planks()), (roof, Tiles())],
                                   (2.3, -1.4, 0.0), 0.5))  # fmt: skip


def _walls(world: Builder) -> None:
    """The yard's wall, open at the gate, and hedges behind it."""
    x, y = YARD
    runs = [((-x, -y), (-1.8, -y)), ((2.6, -y), (x, -y)), ((x, -y), (x, -3.2)),
            ((-x, -y), (-x, -0.2)), ((-x, 7.9), (-x, y + 3.5)), ((x, 9.0), (x, y + 3.5)),
            ((-x, y + 3.5), (x, y + 3.5))]  # fmt: skip
    for (ax, ay), (bx, by) in runs:
        length, heading = float(np.hypot(bx - ax, by - ay)), float(np.arctan2(by - ay, bx - ax))
        shape = placed(box((length, 0.5, 1.5)), ((ax + bx) / 2, (ay + by) / 2, 0.0), heading)
        world.add("wall", [(shape, stone_wall)])
    for gate in (-1.8, 2.6):
        world.add("pillar", [(placed(box((0.8, 0.8, 2.2)), (gate, -y, 0.0)), stone_wall)])
    for index, (hx, hy, length, heading) in enumerate(
        ((-16.0, 2.0, 9.0, 1.45), (-3.0, 15.6, 12.0, 0.1))
    ):
        world.add(
            "hedge",
            things.moved(things.hedge(length, 1.3, 1.7, 40 + index), (hx, hy, 0.0), heading),
        )


def _trees(world: Builder, rng: np.random.Generator) -> None:
    """Trees on fixed places, their size and shape drawn."""
    places = [(-15.5, -10.0), (-19.0, -4.5), (-14.5, 11.0), (16.0, -14.0), (19.5, 2.0), (13.5, 18.5),
              (-6.5, -14.5), (4.2, 12.6), (22.0, -6.0), (-24.0, 8.0), (-26.0, -14.0), (28.0, -16.0)]  # fmt: skip
    for index, (x, y) in enumerate(places):
        tall, seed = rng.uniform(5.5, 8.5), int(rng.integers(1 << 30))
        kind = things.conifer if index % 4 == 3 else things.tree
        parts = kind(tall, tall * rng.uniform(0.62, 0.8), seed)
        ground_level = float(height(x, y))
        world.add("tree", things.moved(parts, (x, y, ground_level - 0.1), rng.uniform(0, 6)))


def cameras(seed: int, settings: Settings) -> list[Camera]:
    """Two oblique rings and nadir lines over the farm.

    Args:
        seed: Decides how far each view is off its ring or line.
        settings: Size and number of the views.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 1)))
    middle = np.array([0.0, 0.5, 1.0])
    size, focal = (settings.width, settings.height), 0.95 * settings.width
    places = ring(settings.oblique, 25.0, 19.0, middle, 0.1, 0.5, rng)
    places += ring(settings.oblique, 21.0, 26.0, middle, 0.36, 0.5, rng)
    nx, ny = settings.nadir
    places += strips((-9.0, 9.0, nx), (-8.0, 8.0, ny), 30.0, 0.05, 0.5, rng)
    return [looking(eye, target, size, focal) for eye, target in places]


def plan(seed: int = 0, settings: Settings = Settings()) -> Plan:
    """The whole scene of a seed.

    Args:
        seed: Another seed makes other trees, tones and small things on the same farm; 0 or more.
        settings: How large the scene is taken.
    """
    views = cameras(seed, settings)
    shots = tuple(
        Shot(name=f"view_{index:03d}.png", camera=camera) for index, camera in enumerate(views)
    )
    world = build(seed)

    def stage() -> Stage:
        caster = Caster(world)
        return Stage(
            caster=caster, lighting=daylight(caster),
            object_seeds=object_seeds(len(world.kinds), seed),
        )  # fmt: skip

    return Plan(
        world="courtyard", settings=asdict(settings), seed=seed, shots=shots,
        stage=once(stage), samples=settings.samples, kinds={"": world.kinds},
    )  # fmt: skip


def daylight(caster: Caster) -> Daylight:
    """A summer afternoon."""
    return Daylight(caster, Sky(azimuth=-0.9, elevation=0.80), (-32, -32, -1), (32, 32, 13), 1.25)
