"""A street as it stands still: carriageway, crossing, houses with shops, trees, lamps, parked cars."""

import numpy as np
import torch

from splatproof.datasets.procedural import things
from splatproof.datasets.procedural.blocks import parked_car
from splatproof.datasets.procedural.city_ground import pavement
from splatproof.datasets.procedural.facades import Facade, Solid, stones
from splatproof.datasets.procedural.grounds import asphalt_colour, grass_colour, plain
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.shapes import box, cylinder, joined, placed, polygon
from splatproof.datasets.procedural.surface import Paint, Surface, layered, mix, palette, rgb, step
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import Builder

CARRIAGE, WALK = 6.6, 3.4
"""Half-width of the carriageway and width of each pavement in metres."""
CROSSING = 34.0
"""Where the side street crosses, metres along the street."""
SIDE, SIDE_WALK = 4.5, 2.4
"""Half-width of the side street's carriageway and width of its pavements in metres."""
DEEP = 11.0
"""Depth of a house in metres."""
SIDE_END = 100.0
"""Metres from the middle of the street to the houses that close the side street."""
TONES = ("d8c9a8", "c7a682", "b9705a", "cbc6bb", "a8583f", "dcd5c5", "9fa6a0")


def ground(surface: Surface) -> Paint:
    """Carriageway, crossing, pavements, gardens behind the houses."""
    p = surface.points[:, :2]
    main, side = p[:, 1].abs(), (p[:, 0] - CROSSING).abs()
    on_main, on_side = (
        step(CARRIAGE + 0.02, CARRIAGE, main),
        step(SIDE + 0.02, SIDE, side),
    )
    road = 1 - (1 - on_main) * (1 - on_side)
    walk = torch.maximum(step(CARRIAGE + WALK + 0.1, CARRIAGE + WALK, main),
                         step(SIDE + SIDE_WALK, SIDE + SIDE_WALK - 0.1, side))  # fmt: skip
    middle = (side > SIDE + 2).float()
    dash = ((main < 0.08) | ((main - 3.3).abs() < 0.06)) & (
        torch.remainder(p[:, 0] / 4.5, 1) < 0.55
    )
    stripes = torch.remainder(p[:, 1], 1.1) < 0.55
    zebra = ((side - SIDE - 3.0).abs() < 1.5) & stripes & (main < CARRIAGE - 0.5)
    kerb = ((main - CARRIAGE).abs() < 0.12) & (side > SIDE)
    drain = ((main - CARRIAGE + 0.5).abs() < 0.22) & (torch.remainder(p[:, 0], 14.0) < 0.5)
    return Paint(albedo=layered(surface, [
        (None, grass_colour), (walk, pavement), (road, asphalt_colour),
        (0.8 * dash.float() * middle, plain("d8d6ce")), (0.8 * zebra.float(), plain("dddbd4")),
        (kerb.float(), plain("b5b1a9")), (drain.float(), plain("2a2a2b")),
    ]))  # fmt: skip


def shopfront(surface: Surface) -> Paint:
    """Ground floors with shop windows; coords are (u, v, width, height)."""
    u, v, width, _ = surface.coords.unbind(dim=1)
    bay = width / (width / 3.6).floor().clamp(min=1)
    x = u - ((u / bay).floor() + 0.5) * bay
    pane = (x.abs() < bay / 2 - 0.3) & (v > 0.55) & (v < 2.6) & ((x.abs() - 0.6).abs() > 0.04)
    sign = (v > 2.8) & (v < 3.3)
    plane = torch.stack([u + 31 * surface.seeds, v], dim=1)
    foot = surface.footprint
    goods = fbm(plane * torch.tensor([1.0, 1.4]), 0.9, 5, 601, foot)
    tone = palette(["3f4a44", "5b3a33", "2f3c52", "6a6358", "4a4440"], surface.seeds)
    board = palette(["c9b58a", "8c2f2b", "2f5a48", "d6d2c6"], torch.remainder(5 * surface.seeds, 1))
    shelf = (torch.remainder(v, 0.55) < 0.05).float()
    inside = mix(rgb("15181b"), rgb("8c7a64"), step(0.42, 0.75, goods) * (1 - shelf))
    letters = step(0.52, 0.56, fbm(plane * torch.tensor([2.2, 0.8]), 0.5, 2, 602, foot))
    colour = tone * (0.75 + 0.5 * fbm(plane, 1.0, 4, 603, foot))[:, None]
    colour = torch.where(sign[:, None], mix(board, rgb("26282b"), 0.85 * letters), colour)
    colour = torch.where((v < 0.5)[:, None], stones(plane, foot), colour)
    return Paint(albedo=torch.where(pane[:, None], inside, colour), gloss=0.9 * pane.float())


def build(seed: int, end: Number) -> Builder:
    """Everything that stands still.

    Args:
        seed: Another seed makes other houses, trees and parked cars.
        end: Metres along the street to which there are houses.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 51)))
    world = Builder()
    far = SIDE_END + 30
    flat = polygon([[-60, -far, 0], [end + 60, -far, 0], [end + 60, far, 0], [-60, far, 0]])
    world.add("ground", [(flat, ground)])
    for side in (-1.0, 1.0):
        x = -45.0
        while x < end:
            long = float(rng.uniform(8.0, 15.0))
            if abs(x + long / 2 - CROSSING) > long / 2 + 7.0:
                middle = (x + long / 2, side * (CARRIAGE + WALK + DEEP / 2 + 0.05), 0.0)
                world.add("building", things.moved(_house(long, rng), middle))
            x += long
        for x in np.arange(-30.0, end, 11.0):
            if abs(x - CROSSING) > 9:
                _tree(world, x + rng.uniform(-1, 1), side, rng)
                _lamp(world, x + 5.5, side)
        for x in np.arange(-25.0, end, 6.2):
            if rng.random() < 0.55 and abs(x - CROSSING) > 10:
                parked_car(world, x, side * (CARRIAGE - 1.15), 0.0, rng)
    _side_street(world, rng)
    return world


def _side_street(world: Builder, rng: np.random.Generator) -> None:
    """Rows of houses along the side street, and one across each of its ends."""
    for side in (-1.0, 1.0):
        for edge in (-1.0, 1.0):
            y = CARRIAGE + WALK + DEEP + 0.2
            x = CROSSING + edge * (SIDE + SIDE_WALK + DEEP / 2 + 0.05)
            while y < SIDE_END - 16:
                long = float(rng.uniform(8.0, 15.0))
                place = (x, side * (y + long / 2), 0.0)
                world.add("building", things.moved(_house(long, rng), place, np.pi / 2))
                y += long
        across = (CROSSING, side * (SIDE_END + DEEP / 2), 0.0)
        world.add("building", things.moved(_house(60.0, rng), across))


def _house(long: Number, rng: np.random.Generator) -> things.Parts:
    """A house in a row along x: shop below, storeys above, a gabled or a flat roof."""
    floors = int(rng.integers(2, 5))
    wall = Facade(tones=TONES, storey=3.0, bay=float(rng.choice([2.3, 2.7, 3.2])), door=False,
                  brick=bool(rng.random() < 0.35), shutters=bool(rng.random() < 0.4))  # fmt: skip
    x, y = long / 2, DEEP / 2
    shop = [(things.walls([[-x, -y], [x, -y], [x, y], [-x, y]], 0.0, 3.6), shopfront)]
    if rng.random() < 0.6:
        upper = things.house(long, DEEP, 3.0 * floors, float(rng.uniform(3, 4.5)), wall)
    else:
        upper = things.flat_house((long, DEEP, 3.0 * floors + 0.6), wall, rng)
    return [*shop, *things.moved(upper, (0.0, 0.0, 3.6))]


def _tree(world: Builder, x: Number, side: Number, rng: np.random.Generator) -> None:
    """A street tree: its crown is narrow enough for the pavement and begins above heads."""
    tall, spread = rng.uniform(6.0, 7.5), rng.uniform(2.4, 2.9)
    parts = things.tree(tall, spread, int(rng.integers(1 << 30)), 3)
    place = (x, side * (CARRIAGE + 0.9), -0.1)
    world.add("tree", things.moved(parts, place, rng.uniform(0, 6)))


def _lamp(world: Builder, x: Number, side: Number) -> None:
    """A street lamp that leans over the road."""
    pole = cylinder(0.09, 6.5, 8, 0.06)
    arm = placed(box((0.08, 1.8, 0.08)), (0.0, -0.85 * side, 6.4))
    head = placed(box((0.25, 0.6, 0.12)), (0.0, -1.6 * side, 6.32))
    grey = Solid(tone="5d6266", dirt=0.3)
    world.add("lamp", [(placed(joined(pole, arm, head), (x, side * (CARRIAGE + 0.5), 0.0)), grey)])
