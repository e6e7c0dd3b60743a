"""Textures of the ground, as functions of world position."""

from collections.abc import Callable
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural.noise import cell_random, fbm, inner, visible
from splatproof.datasets.procedural.surface import Paint, Surface, mix, rgb, step
from splatproof.datasets.procedural.units import Number


def plain(tone: str) -> Callable[[Surface], Float[Tensor, "n 3"]]:
    """One colour everywhere."""
    return lambda surface: rgb(tone).expand(len(surface.points), 3)


def grass(surface: Surface) -> Paint:
    """Unmown lawn: patches, dry spots, tufts and scattered flowers."""
    return Paint(albedo=grass_colour(surface))


def grass_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Albedo of grass."""
    p, foot = surface.points[:, :2], surface.footprint
    patch = fbm(p, 14.0, 4, 1, foot)
    tuft = fbm(p, 1.1, 4, 2, foot)
    colour = mix(rgb("3f5a26"), rgb("7c8a45"), step(0.32, 0.68, patch))
    colour = mix(colour, rgb("a39a62"), 0.7 * step(0.55, 0.72, fbm(p, 6.0, 3, 3, foot)))
    colour = colour * (0.45 + 1.1 * tuft)[:, None]
    clover = step(0.62, 0.7, fbm(p, 2.6, 3, 5, foot))
    colour = mix(colour, rgb("2f5426"), 0.55 * clover)
    flowers = step(0.70, 0.76, fbm(p, 0.5, 2, 4, foot)) * step(0.5, 0.6, patch)
    return mix(colour, rgb("d9cf8a"), 0.6 * flowers)


def gravel_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Albedo of trodden gravel with puddle stains and wheel marks."""
    p, foot = surface.points[:, :2], surface.footprint
    stones = fbm(p, 0.45, 3, 11, foot)
    stain = fbm(p, 5.0, 5, 12, foot)
    colour = mix(rgb("7d7263"), rgb("b8ab95"), step(0.3, 0.7, stain))
    return colour * (0.62 + 0.75 * stones)[:, None]


def soil_colour(surface: Surface, heading: Number = 0.35) -> Float[Tensor, "n 3"]:
    """Albedo of a field in rows of young crop on brown soil.

    Args:
        surface: The points.
        heading: Direction of the rows, in radians counter-clockwise from +x.
    """
    p, foot = surface.points[:, :2], surface.footprint
    across = torch.tensor([-torch.sin(torch.tensor(heading)), torch.cos(torch.tensor(heading))])
    bend = fbm(p, 9.0, 2, 21) * 0.8
    row = torch.sin((inner(p, across) + bend) * (2 * torch.pi / 0.9)) * visible(0.9, foot)
    crop = step(-0.1, 0.9, row + 1.6 * (fbm(p, 2.2, 4, 22, foot) - 0.5))
    soil = mix(rgb("5a4433"), rgb("8d7358"), fbm(p, 3.0, 5, 23, foot))
    green = mix(rgb("4c6b2c"), rgb("7f9446"), fbm(p, 7.0, 4, 24, foot))
    return mix(soil, green, crop * (0.25 + 0.75 * step(0.35, 0.6, fbm(p, 18.0, 3, 25))))


def asphalt_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Albedo of old asphalt with patches, cracks and oil."""
    p, foot = surface.points[:, :2], surface.footprint
    grain = fbm(p, 0.3, 2, 31, foot)
    wear = fbm(p, 4.0, 4, 32, foot)
    mended = step(0.60, 0.61, fbm(p, 7.0, 1, 33))
    crack = 1 - step(0.0, 0.02, (fbm(p, 3.0, 4, 34) - 0.5).abs())
    colour = mix(rgb("55565a"), rgb("7b7974"), wear) * (0.75 + 0.5 * grain)[:, None]
    colour = mix(colour, rgb("3f4044"), 0.6 * mended)
    return mix(colour, rgb("2c2c2e"), 0.6 * crack * visible(0.12, foot))


def paving_colour(
    surface: Surface, size: tuple[float, float] = (0.9, 0.6), tone: str = "a59c8e"
) -> Float[Tensor, "n 3"]:
    """Albedo of stone slabs laid in courses, each with its own shade.

    Args:
        surface: The points.
        size: Sides of a slab along x and y, in metres.
        tone: Mean colour as an sRGB code.
    """
    p, foot = surface.points[:, :2], surface.footprint
    row = torch.floor(p[:, 1] / size[1])
    x = p[:, 0] / size[0] + 0.5 * torch.remainder(row, 2)
    column = torch.floor(x)
    shade = cell_random(torch.stack([column, row], dim=1), 41)
    inside = _gap((x - column) * size[0], size[0]) * _gap(p[:, 1] - row * size[1], size[1])
    joint = (1 - inside) * visible(2 * size[1], foot)
    colour = (
        rgb(tone)
        * (0.66 + 0.6 * shade * visible(size[1], foot) + 0.3 * fbm(p, 0.8, 4, 42, foot))[:, None]
    )
    return mix(colour, rgb("4d483f"), 0.75 * joint)


def _gap(x: Float[Tensor, " n"], size: Number, joint: Number = 0.05) -> Float[Tensor, " n"]:
    """1 inside a slab, 0 in the joint at its edges."""
    return step(joint * 0.4, joint, x) * step(joint * 0.4, joint, size - x)


def water(surface: Surface) -> Paint:
    """Still water with ripples that mirror the sky."""
    p = surface.points[:, :2]
    ripple = torch.stack([fbm(p, 1.5, 3, 51) - 0.5, fbm(p, 1.5, 3, 52) - 0.5], dim=1)
    bump = torch.cat([0.10 * ripple, torch.zeros(len(p), 1)], dim=1)
    depth = fbm(p, 10.0, 3, 53)
    return Paint(
        albedo=mix(rgb("27413c"), rgb("4a6355"), depth), gloss=torch.ones(len(p)), bump=bump
    )


def segment_distance(
    points: Float[Tensor, "n 2"], line: list[tuple[float, float]]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """How far points lie from a line of several segments.

    Args:
        points: Positions in metres.
        line: Corners (x, y) of the line in metres, two or more.
    Returns: Distance of each point, and how far along the line its nearest place is, in metres.
    """
    best = torch.full_like(points[:, 0], torch.inf)
    along = torch.zeros_like(best)
    walked = 0.0
    for start, end in pairwise(line):
        a, b = torch.tensor(start), torch.tensor(end)
        length = float((b - a).norm())
        t = (inner(points - a, b - a) / length**2).clamp(0, 1)
        away = (points - a - t[:, None] * (b - a)).norm(dim=1)
        along = torch.where(away < best, walked + t * length, along)
        best = torch.minimum(best, away)
        walked += length
    return best, along
