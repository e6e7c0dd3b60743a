"""Textures of buildings: walls with windows, bricks, wood, roofs, metal."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural.noise import cell_random, fbm, visible
from splatproof.datasets.procedural.surface import Paint, Surface, mix, palette, rgb, step


@dataclass(frozen=True)
class Facade:
    """A wall with rows of windows; coords are (u, v, width, height) of the wall in metres."""

    tones: tuple[str, ...] = ("d8cbb2", "c9b08a", "cfd0c8", "d9d2c4", "b98f74")
    """Plaster or brick colours; a building takes one."""
    storey: float = 2.9
    bay: float = 2.7
    window: tuple[float, float] = (1.1, 1.4)
    """Width and height of a window."""
    brick: bool = False
    door: bool = True
    shutters: bool = True

    def __call__(self, surface: Surface) -> Paint:
        """Colour and gloss."""
        u, v, width, height = surface.coords.unbind(dim=1)
        foot = surface.footprint
        plane = torch.stack([u + 37 * surface.seeds, v], dim=1)
        colour = self._wall(surface, plane)
        bays = (width / self.bay).floor().clamp(min=1)
        bay = width / bays
        column = (u / bay).floor()
        row = (v / self.storey).floor()
        x = u - (column + 0.5) * bay
        y = v - row * self.storey
        cells = torch.stack([column + (97 * surface.seeds).floor(), row + 3 * width.floor()], dim=1)
        luck = cell_random(cells, 61)
        door = (row == 0) & (column == (bays / 2).floor()) if self.door else torch.zeros_like(u) > 0
        tall = torch.where(door, 2.2, self.window[1])
        base = torch.where(door, 0.0, 0.9)
        wide = torch.where(door, self.window[0] * 1.05, self.window[0]) / 2
        inside_x, middle = wide - x.abs(), y - base - tall / 2
        inside_y = tall / 2 - middle.abs()
        fits = (row + 1) * self.storey < height + 0.35 * self.storey
        there = fits & (bay > self.window[0] + 0.3) & ((luck > 0.12) | door)
        inside = torch.minimum(inside_x, inside_y)
        frame = (inside > -0.12) & there
        glass = (inside > 0.06) & there & ~door
        bars = (x.abs() < 0.035) | ((middle - 0.25).abs() < 0.03)
        glass = glass & ~bars
        dark = mix(rgb("20262c"), rgb("5b6670"), step(0.3, 1.0, luck))
        dark = mix(dark, rgb("b5ad9b"), 0.75 * step(0.78, 0.8, luck) * step(-0.1, 0.1, middle))
        trim = palette(["e6e2d8", "6b5644", "d5d8da", "8b4f3b"], surface.seeds)
        leaf = palette(
            ["5a3d2b", "31463c", "6d2f27", "3d4756"], torch.remainder(7 * surface.seeds, 1)
        )
        colour = torch.where(frame[:, None], trim, colour)
        colour = torch.where((door & there & (inside > 0.06))[:, None], leaf, colour)
        colour = torch.where(glass[:, None], dark, colour)
        if self.shutters:
            beside = (x.abs() > wide + 0.12) & (x.abs() < wide + 0.55) & (inside_y > -0.02)
            slats = 0.8 + 0.25 * torch.sin(y * 50) * visible(0.13, foot)
            colour = torch.where((beside & there & ~door)[:, None], leaf * slats[:, None], colour)
        sill = (inside_x > -0.2) & (y < base) & (y > base - 0.13) & there & ~door
        colour = torch.where(sill[:, None], rgb("b3aca0"), colour)
        return Paint(albedo=colour, gloss=glass.float())

    def _wall(self, surface: Surface, plane: Float[Tensor, "n 2"]) -> Float[Tensor, "n 3"]:
        """The wall itself: plaster or bricks, stained, with a stone base."""
        v, foot = surface.coords[:, 1], surface.footprint
        tone = palette(list(self.tones), surface.seeds)
        if self.brick:
            tone = _bricks(plane, tone, foot)
        stain = fbm(plane * torch.tensor([1.0, 0.35]), 2.4, 5, 62, foot)
        colour = tone * (0.62 + 0.7 * stain)[:, None]
        patches = step(0.60, 0.66, fbm(plane, 3.2, 4, 63, foot))
        colour = mix(colour, tone * 0.62, 0.5 * patches)
        damp = step(1.6, 0.2, v + 1.5 * (fbm(plane, 1.7, 3, 64, foot) - 0.5))
        colour = mix(colour, rgb("6f6a58"), 0.45 * damp)
        return torch.where((v < 0.45)[:, None], stones(plane, foot), colour)


def _bricks(
    plane: Float[Tensor, "n 2"], tone: Float[Tensor, "n 3"], foot: Float[Tensor, " n"]
) -> Float[Tensor, "n 3"]:
    """Courses of bricks 0.5 x 0.18 m with light joints, each brick of its own shade."""
    row = (plane[:, 1] / 0.18).floor()
    x = plane[:, 0] / 0.5 + 0.5 * torch.remainder(row, 2)
    column = x.floor()
    shade = cell_random(torch.stack([column, row], dim=1), 65)
    joint = ((x - column) < 0.06) | ((plane[:, 1] / 0.18 - row) < 0.14)
    colour = tone * (1 + 0.55 * (shade - 0.5) * visible(0.4, foot))[:, None]
    return mix(colour, rgb("b7ad9e"), 0.6 * joint.float() * visible(0.2, foot) + 0.12)


def stones(plane: Float[Tensor, "n 2"], foot: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    """Colour of rough field stones in mortar.

    Args:
        plane: Positions on the wall, across and upwards, in metres.
        foot: Metres between neighbouring samples; detail that they cannot carry fades out.
    """
    warped = plane + 0.18 * torch.stack(
        [fbm(plane, 0.7, 2, 66) - 0.5, fbm(plane, 0.7, 2, 67) - 0.5], dim=1
    )
    row = (warped[:, 1] / 0.32).floor()
    x = warped[:, 0] / 0.5 + 0.37 * row
    column = x.floor()
    shade = cell_random(torch.stack([column, row], dim=1), 68)
    hue = cell_random(torch.stack([column, row], dim=1), 69)
    edge = torch.minimum((x - column) * 0.5, (warped[:, 1] / 0.32 - row) * 0.32)
    colour = mix(rgb("8e8272"), rgb("a99a86"), hue) * (0.6 + 0.75 * shade)[:, None]
    colour = colour * (0.7 + 0.6 * fbm(plane, 0.4, 3, 70, foot))[:, None]
    return mix(colour, rgb("5b5348"), 0.7 * step(0.06, 0.02, edge) * visible(0.3, foot))


def stone_wall(surface: Surface) -> Paint:
    """A dry stone wall; coords are (u, v, ...)."""
    colour = stones(surface.coords[:, :2], surface.footprint)
    lichen = step(0.58, 0.66, fbm(surface.coords[:, :2], 1.3, 4, 71, surface.footprint))
    return Paint(albedo=mix(colour, rgb("a3a06a"), 0.5 * lichen))


@dataclass(frozen=True)
class Tiles:
    """A tiled roof; coords are (u along the eave, v up the slope, ...)."""

    tones: tuple[str, ...] = ("94604a", "86564a", "6d5248", "a06f52", "5c5f66")
    tile: tuple[float, float] = (0.42, 0.5)

    def __call__(self, surface: Surface) -> Paint:
        """Colour, with tiles that rise towards their lower edge."""
        u, v = surface.coords[:, 0], surface.coords[:, 1]
        foot = surface.footprint
        tone = palette(list(self.tones), torch.remainder(surface.seeds * 13, 1))
        row = (v / self.tile[1]).floor()
        x = u / self.tile[0] + 0.5 * torch.remainder(row, 2)
        column = x.floor()
        shade = cell_random(torch.stack([column, row], dim=1), 72)
        down = v / self.tile[1] - row
        carried = visible(1.3 * self.tile[1], foot)
        colour = tone * (1 + 0.7 * (shade - 0.5) * carried)[:, None]
        colour = colour * (1 - 0.45 * step(0.22, 0.0, down) * carried)[:, None]
        colour = colour * (1 - 0.3 * (2 * (x - column) - 1).abs() ** 3 * carried)[:, None]
        plane = surface.coords[:, :2] + 50 * surface.seeds[:, None]
        weather = fbm(plane, 3.5, 5, 73, foot)
        colour = colour * (0.6 + 0.75 * weather)[:, None]
        moss = step(0.60, 0.72, fbm(plane, 2.2, 4, 74, foot))
        return Paint(albedo=mix(colour, rgb("5f6a3c"), 0.6 * moss))


@dataclass(frozen=True)
class Planks:
    """Weathered boards of a barn; coords are (u, v, ...)."""

    tone: str = "75604c"

    def __call__(self, surface: Surface) -> Paint:
        """Colour."""
        plane, foot = surface.coords[:, :2], surface.footprint
        board = (plane[:, 0] / 0.35).floor()
        luck = cell_random(torch.stack([board, board * 0], dim=1), 75)
        grain = fbm(plane * torch.tensor([4.0, 0.4]), 1.0, 4, 76, foot)
        gap = (plane[:, 0] / 0.35 - board) < 0.1
        colour = rgb(self.tone) * (0.55 + 0.55 * luck + 0.5 * grain)[:, None]
        return Paint(albedo=mix(colour, rgb("2c241c"), 0.8 * gap.float() * visible(0.3, foot)))


@dataclass(frozen=True)
class Solid:
    """One tone with some dirt; coords are positions."""

    tone: str
    gloss: float = 0.0
    dirt: float = 0.5

    def __call__(self, surface: Surface) -> Paint:
        """Colour and gloss."""
        dirt = fbm(surface.coords[:, :3], 0.9, 4, 77, surface.footprint)
        colour = rgb(self.tone) * (1 + self.dirt * 2 * (dirt - 0.5))[:, None]
        return Paint(albedo=colour, gloss=torch.full_like(dirt, self.gloss))


def flat_roof(surface: Surface) -> Paint:
    """Bitumen sheets under gravel, with puddle stains; coords are (u, v, ...)."""
    plane, foot = surface.coords[:, :2] + 60 * surface.seeds[:, None], surface.footprint
    tone = palette(["7d7a75", "8f8a80", "6a6866", "a39c8f"], torch.remainder(11 * surface.seeds, 1))
    stain = fbm(plane, 5.0, 5, 78, foot)
    grain = fbm(plane, 0.5, 2, 79, foot)
    seam = (torch.remainder(plane[:, 0] / 1.8, 1) < 0.06).float() * visible(1.0, foot)
    colour = tone * (0.5 + 0.7 * stain + 0.3 * grain)[:, None]
    puddle = step(0.58, 0.62, fbm(plane, 4.0, 3, 80, foot))
    colour = mix(colour, rgb("4a4948"), 0.5 * puddle)
    return Paint(albedo=mix(colour, rgb("3c3b3a"), 0.5 * seam))
