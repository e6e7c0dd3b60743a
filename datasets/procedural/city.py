"""A city from a high nadir flight, and the low oblique and facade views that the flight never had."""

from dataclasses import asdict, dataclass

import numpy as np
import torch

from splatproof.datasets.procedural.blocks import BLOCKS, parked_car, tree
from splatproof.datasets.procedural.city_ground import (
    KINDS,
    PITCH,
    RIVER,
    ROAD,
    WALK,
    CityGround,
    Kinds,
    height,
)
from splatproof.datasets.procedural.daylight import Daylight, Sky
from splatproof.datasets.procedural.flights import looking, strips
from splatproof.datasets.procedural.grounds import water
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.plan import Plan, Shot, Stage, object_seeds, once
from splatproof.datasets.procedural.shapes import heightfield, polygon
from splatproof.datasets.procedural.tiles import Sketch, TiledStage
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import Builder, World

UNSEEN = "unseen"
"""Group of the views that no method trains on."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How large the city is and how it is flown over."""

    blocks: tuple[int, int] = (3, 2)
    """Blocks along x and y."""
    width: int = 280
    height: int = 210
    altitude: float = 105.0
    """Metres above the streets."""
    overlap: tuple[float, float] = (0.72, 0.62)
    """Share of the footprint that neighbouring views share, along and across the lines."""
    oblique: int = 5
    """Low oblique views that no training view has."""
    facade: int = 5
    """Views of facades from the streets, which no training view has either."""
    cell: float = 3.0
    """Metres between the places where sky light is known."""
    samples: int = 3
    tiles: int = 0
    """Blocks whose triangles are kept between views, which then see no more than the blocks about
    them; 0: the whole city stands in memory."""


PRESETS = {
    "small": Settings(),
    "medium": Settings(blocks=(6, 5), width=640, height=480, oblique=24, facade=24),
    "large": Settings(
        blocks=(20, 20), width=1600, height=1200, oblique=200, facade=200, cell=6.0,
        overlap=(0.8, 0.7), tiles=120,
    ),
}  # fmt: skip


def build(seed: int, kinds: Kinds, margin: Number, river: bool = True) -> World:
    """The city of one seed, all at once.

    Args:
        seed: Another seed puts other houses, trees and cars on the same blocks.
        kinds: Index into KINDS for each block, by column (x) and row (y).
        margin: Metres of open land around the blocks.
        river: Whether one runs along the last row.
    """
    world = Builder()
    furnish(world, seed, kinds, margin, river)
    return world.build()


def furnish(world: Builder, seed: int, kinds: Kinds, margin: Number, river: bool = True) -> None:
    """Put the city of one seed into a builder.

    Args:
        world: Gets everything.
        seed: Another seed puts other houses, trees and cars on the same blocks.
        kinds: Index into KINDS for each block, by column (x) and row (y).
        margin: Metres of open land around the blocks.
        river: Whether one runs along the last row.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 3)))
    nx, ny = len(kinds), len(kinds[0])
    half = np.array([nx, ny]) * PITCH / 2
    xs, ys = (np.arange(-h - margin, h + margin + 4, 4.0) for h in half)
    x, y = np.meshgrid(xs, ys)
    world.add("ground", [(heightfield(xs, ys, height(x, y, half, river)), CityGround(kinds))])
    far, low, high = half[0] + margin, half[1] + 12, half[1] + 12 + RIVER
    if river:
        sheet = [[-far, low, -1.1], [far, low, -1.1], [far, high, -1.1], [-far, high, -1.1]]
        world.add("water", [(polygon(sheet), water)])
    for column in range(nx):
        for row in range(ny):
            centre = (np.array([column, row]) + 0.5) * PITCH - half
            BLOCKS[KINDS[kinds[column][row]]](world, centre, rng)
    _street_furniture(world, half, nx, ny, rng)
    for _ in range(int(0.0016 * 4 * far * (half[1] + margin))):
        x, y = rng.uniform(-far, far), rng.uniform(-half[1] - margin, half[1] + margin)
        beside = max(abs(x) - half[0], abs(y) - half[1]) > 9
        if beside and not (river and low - 3 < y < high + 3) and _wooded(x, y):
            tree(world, x, y, rng, float(height(np.array([x]), np.array([y]), half, river)[0]))


def _wooded(x: Number, y: Number) -> bool:
    """Where woods stand outside the city."""
    return float(fbm(torch.tensor([[x, y]], dtype=torch.float32), 40.0, 2, 303)[0]) > 0.5


def draw_kinds(seed: int, nx: int, ny: int) -> Kinds:
    """Kinds of blocks in random places, each kind as often as the others, give or take one.

    Args:
        seed: Decides the places.
        nx: Number of blocks along x.
        ny: Number of blocks along y.
    Returns: Index into KINDS for each block, by column (x) and row (y).
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    cells = [(x, y) for x in range(nx) for y in range(ny)]
    draw = rng.permutation(len(cells))
    kinds = {cells[index]: int(n % len(KINDS)) for n, index in enumerate(draw)}
    return tuple(tuple(kinds[x, y] for y in range(ny)) for x in range(nx))


def _street_furniture(
    world: Builder, half: np.ndarray, nx: int, ny: int, rng: np.random.Generator
) -> None:
    """Parked cars and street trees along every street."""
    for axis, (lines, length) in enumerate(((nx, half[1]), (ny, half[0]))):
        for line in range(lines + 1):
            across = line * PITCH - half[axis]
            for along in np.arange(-length + 11, length - 10, 7.0):
                if abs(np.remainder(along + length, PITCH) - PITCH / 2) > PITCH / 2 - 11:
                    continue
                for side in (-1, 1):
                    spot = across + side * (ROAD - 1.2)
                    place = (spot, along) if axis == 0 else (along, spot)
                    if rng.random() < 0.4:
                        parked_car(world, *place, np.pi / 2 * (1 - axis), rng)
                    elif rng.random() < 0.3:
                        spot = across + side * (ROAD + WALK - 0.9)
                        tree(world, *((spot, along) if axis == 0 else (along, spot)), rng)


def shots(seed: int, settings: Settings) -> tuple[Shot, ...]:
    """Nadir lines over the city; oblique and facade views in a group of their own.

    Args:
        seed: Decides how far the flight is off its lines, and where other views look.
        settings: Extent of the city, the flight over it, size and number of the views.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 1)))
    size, focal = (settings.width, settings.height), 1.05 * settings.width
    half = np.array(settings.blocks) * PITCH / 2
    cover = settings.altitude / focal * np.array(size)
    counts = [
        max(2, int(np.ceil(2 * h / (side * (1 - share)))) + 1)
        for h, side, share in zip(half, cover, settings.overlap, strict=True)
    ]
    x, y = ((-h * 0.95, h * 0.95, n) for h, n in zip(half, counts, strict=True))
    found = []
    for index, (eye, target) in enumerate(strips(x, y, settings.altitude, 0.03, 0.8, rng)):
        camera = looking(eye, target, size, focal)
        found.append(Shot(name=f"nadir_{index:05d}.png", camera=camera))
    for index in range(settings.oblique):
        angle = 2 * np.pi * (index + 0.3) / settings.oblique
        target = np.append(rng.uniform(-0.5, 0.5, 2) * half, 4.0)
        eye = target + np.array([np.cos(angle) * 60, np.sin(angle) * 60, 42.0])
        camera = looking(eye, target, size, focal)
        found.append(Shot(name=f"oblique_{index:05d}.png", camera=camera, group=UNSEEN))
    for index in range(settings.facade):
        eye, target = _street_view(settings, rng)
        lens = 1.1 if settings.tiles else 0.8
        camera = looking(eye, target, size, lens * settings.width)
        found.append(Shot(name=f"facade_{index:05d}.png", camera=camera, group=UNSEEN))
    return tuple(found)


def _street_view(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An eye above a street's middle, and a place across the street, at the houses of a block."""
    axis = int(rng.integers(2))
    half = np.array(settings.blocks) * PITCH / 2
    line = int(rng.integers(0, settings.blocks[axis]))
    eye = np.zeros(3)
    eye[axis] = line * PITCH - half[axis]
    eye[1 - axis] = rng.uniform(-0.7, 0.7) * half[1 - axis]
    eye[2] = rng.uniform(8.0, 12.0)
    ahead = np.zeros(3)
    # where the city is built by tiles, no view reaches the horizon: it would need the whole city
    drop = 8.0 if settings.tiles else 4.5
    ahead[axis], ahead[1 - axis], ahead[2] = 14.0, rng.uniform(-12, 12), -drop
    return eye, eye + ahead


def plan(seed: int, settings: Settings) -> Plan:
    """The whole scene of a seed.

    Args:
        seed: Another seed makes another city; 0 or more.
        settings: How large the city is and how it is flown over.
    """
    kinds = draw_kinds(seed, *settings.blocks)
    half, margin = np.array(settings.blocks) * PITCH / 2, 1.2 * settings.altitude
    sky = Sky(azimuth=0.7, elevation=0.9)
    if settings.tiles:
        sketch = Sketch(PITCH, (-half[0], -half[1]))
        furnish(sketch, seed, kinds, margin)
        names = tuple(sketch.kinds)
        seeds = object_seeds(len(names), seed)
        stage = TiledStage(sketch, sky, (-3.0, 42.0), settings.cell, seeds, settings.tiles)
    else:
        world = build(seed, kinds, margin)
        names = world.kinds

        def whole() -> Stage:
            caster, wide = Caster(world), half + 30
            light = Daylight(caster, sky, (-wide[0], -wide[1], -3.0), (wide[0], wide[1], 42.0),
                             settings.cell)  # fmt: skip
            return Stage(caster=caster, lighting=light, object_seeds=object_seeds(len(names), seed))

        stage = once(whole)
    return Plan(
        world="city", settings=asdict(settings), seed=seed, shots=shots(seed, settings),
        stage=stage, samples=settings.samples, kinds={"": names}, features=600,
        facts={"unseen": "views in the folder unseen are no training views: low oblique and facades"},
    )  # fmt: skip
