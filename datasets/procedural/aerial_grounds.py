"""Grounds of the small aerial scenes, and materials that only they have."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural.facades import Solid, stones
from splatproof.datasets.procedural.grounds import (
    asphalt_colour,
    grass_colour,
    gravel_colour,
    paving_colour,
    plain,
    segment_distance,
    water,
)
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.rock import rock_colour
from splatproof.datasets.procedural.surface import Paint, Surface, layered, mix, rgb, step
from splatproof.datasets.procedural.units import Number

__all__ = ["CHURCH_PATH", "LANE", "WALKS", "Mountain", "ashlar", "banded", "bowl", "churchyard", "container", "near", "park",
           "pond_bed", "stadium", "water", "yard"]  # fmt: skip

Array = Float[np.ndarray, "..."]
Line = list[tuple[float, float]]
LANE: Line = [
    (-320.0, 80.0),
    (-110.0, 34.0),
    (-30.0, 31.0),
    (30.0, 36.0),
    (110.0, 30.0),
    (320.0, 60.0),
]
CHURCH_PATH: Line = [(-22.0, 0.0), (-34.0, 6.0), (-36.0, 31.0)]
WALKS: list[Line] = [
    [(-320.0, -60.0), (-90.0, -30.0), (-25.0, -12.0), (-6.0, -14.0), (14.0, -16.0), (34.0, 2.0),
     (80.0, 30.0), (320.0, 90.0)],
    [(-90.0, 320.0), (-40.0, 80.0), (-22.0, 20.0), (-6.0, -14.0), (-10.0, -80.0), (40.0, -320.0)],
]  # fmt: skip


def ashlar(surface: Surface) -> Paint:
    """Stone of churches and graves, by world position."""
    plane = torch.stack([surface.points[:, 0] + surface.points[:, 1], surface.points[:, 2]], dim=1)
    return Paint(albedo=stones(1.2 * plane, surface.footprint))


def banded(surface: Surface) -> Paint:
    """A brick chimney with bands; coords are positions."""
    z = surface.coords[:, 2]
    soot = fbm(surface.coords[:, :3], 3.0, 4, 401, surface.footprint)
    colour = mix(rgb("9a5c46"), rgb("5d463c"), soot)
    band = (torch.remainder(z, 9.0) > 7.5).float()
    return Paint(albedo=mix(colour, rgb("cfc7b8"), 0.8 * band))


@cache
def container(tone: str) -> Solid:
    """A painted steel container."""
    return Solid(tone=tone, dirt=0.7)


def _lane(surface: Surface) -> Float[Tensor, " n"]:
    away, _ = segment_distance(surface.points[:, :2], LANE)
    return step(3.05, 2.95, away)


def churchyard(surface: Surface) -> Paint:
    """Lawn, gravel paths around a church, a lane."""
    p = surface.points[:, :2]
    edge = 1.5 * (fbm(p, 3.0, 3, 402) - 0.5)
    around = ((p - p.new_tensor([-1.0, 0.0])).abs() / p.new_tensor([26.0, 14.5])).amax(dim=1)
    path, _ = segment_distance(p, CHURCH_PATH)
    return Paint(albedo=layered(surface, [
        (None, grass_colour),
        (step(1.0, 0.96, around + 0.05 * edge), gravel_colour),
        (step(2.0, 1.9, path + 0.3 * edge), paving_colour),
        (_lane(surface), asphalt_colour),
    ]))  # fmt: skip


@dataclass(frozen=True)
class Mountain:
    """Rock, scree, meadow and snow by slope and height."""

    seed: int

    def height(self, x: Array, y: Array) -> Array:
        """Height of a ridge with gullies, in metres.

        Args:
            x: Places in metres.
            y: Places in metres, one for each of `x`.
        """
        p = torch.from_numpy(np.stack([np.ravel(x), np.ravel(y)], axis=1)).float()
        rough = fbm(p, 44.0, 6, 403 + self.seed).numpy().reshape(np.shape(x)).astype(float)
        ridge = np.exp(-(((x + 0.25 * y) / 46) ** 2) - (y / 62) ** 2)
        crest = 1 - np.abs(2 * rough - 1)
        crags = fbm(p, 15.0, 4, 415 + self.seed).numpy().reshape(np.shape(x)).astype(float)
        steep = 9 * ridge * (1 - np.abs(2 * crags - 1) * 2.5)
        return 24 * ridge * (0.35 + 0.85 * crest) + steep + 8 * (rough - 0.5)

    def __call__(self, surface: Surface) -> Paint:
        """Colour."""
        p, z, foot = surface.points, surface.points[:, 2], surface.footprint
        slope = surface.normals[:, 2]
        edge = fbm(p[:, :2], 9.0, 5, 404, foot) - 0.5
        grass = step(0.66, 0.80, slope + 0.4 * edge) * step(19.0, 14.0, z + 12 * edge)
        snow = step(24.0, 25.0, z + 22 * edge) * step(0.72, 0.82, slope)
        scree = step(0.80, 0.9, slope + 0.5 * edge)
        return Paint(albedo=layered(surface, [
            (None, rock_colour), (0.7 * scree, gravel_colour), (grass, grass_colour),
            (0.92 * snow, snow_colour),
        ]))  # fmt: skip


def snow_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Old snow."""
    return mix(rgb("b9c2c9"), rgb("eef1f3"), fbm(surface.points, 2.5, 5, 414, surface.footprint))


def _oval(x: Array, y: Array) -> Array:
    """How far out of a pitch's oval a place lies, 1 on its rim of 38 x 26 metres."""
    return ((np.abs(x) / 38) ** 3 + (np.abs(y) / 26) ** 3) ** (1 / 3)


def bowl(x: Array, y: Array) -> Array:
    """Height of the stands that rise in steps around the pitch, in metres.

    Args:
        x: Places in metres.
        y: Places in metres, one for each of `x`.
    """
    out = (_oval(x, y) - 1) * 30
    rise = np.floor(np.clip(out / 1.25, 0, 11)) * 0.95
    return np.where(out < 15.5, rise, 0.0)


def stadium(surface: Surface) -> Paint:
    """Pitch with lines and mown stripes, a running track, coloured seats, a car park."""
    p = surface.points[:, :2]
    x, y = p[:, 0].abs(), p[:, 1].abs()
    oval = ((x / 38) ** 3 + (y / 26) ** 3) ** (1 / 3)
    stripe = (torch.remainder(p[:, 0] / 5.0, 2) < 1).float()
    near = ((x - 30).abs().minimum((x - 0).abs()) < 0.13) & (y < 19)
    line = near | (((y - 19).abs() < 0.13) & (x < 30)) | ((p.norm(dim=1) - 6).abs() < 0.13)
    box = ((x > 23) & (x < 30) & ((y - 9).abs() < 0.13)) | (((x - 23).abs() < 0.13) & (y < 9))
    lanes = (torch.remainder(oval * 30, 1.0) < 0.1).float()
    seats = (oval > 1.0) & (oval < 1.52)
    rows = torch.remainder((oval - 1) * 24, 1)
    sector = torch.remainder(torch.atan2(p[:, 1], p[:, 0]) * 14 / (2 * torch.pi), 1)
    steps = (sector < 0.06) & seats
    lot = (p[:, 1] < -50) & (p[:, 1] > -72) & (x < 44)
    return Paint(albedo=layered(surface, [
        (None, grass_colour),
        ((oval < 0.84).float() * 0.6, lawn),
        ((oval < 0.84).float() * stripe * 0.35, plain("a3bd62")),
        ((line | box).float() * (oval < 0.84).float() * 0.9, plain("e8e8e0")),
        (((oval >= 0.84) & (oval <= 1.0)).float(), tartan),
        (((oval >= 0.84) & (oval <= 1.0)).float() * lanes * 0.7, plain("e6dccf")),
        (seats.float(), seat_colour),
        (seats.float() * step(0.35, 0.2, rows) * 0.6, plain("55585c")),
        (steps.float(), plain("a8a59d")),
        (((oval >= 1.52) & (oval < 1.75)).float(), paving_colour),
        (lot.float(), asphalt_colour),
    ]))  # fmt: skip


def lawn(surface: Surface) -> Float[Tensor, "n 3"]:
    """Mown grass of a pitch."""
    wear = fbm(surface.points[:, :2], 5.0, 5, 405, surface.footprint)
    return mix(rgb("4d7a35"), rgb("86964f"), step(0.45, 0.75, wear))


def tartan(surface: Surface) -> Float[Tensor, "n 3"]:
    """A running track."""
    dirt = fbm(surface.points[:, :2], 3.0, 4, 406, surface.footprint)
    return rgb("9c4c3a") * (0.7 + 0.6 * dirt)[:, None]


def seat_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Seats in two tones by sector, some taken."""
    p = surface.points[:, :2]
    sector = torch.atan2(p[:, 1], p[:, 0]) * 7 / torch.pi
    tone = torch.where(
        (torch.remainder(sector.floor(), 2) < 1)[:, None], rgb("2f4f86"), rgb("b5b9bf")
    )
    people = step(0.55, 0.62, fbm(p, 0.9, 2, 407, surface.footprint))
    return mix(tone, rgb("8f5a45"), 0.7 * people)


def yard(surface: Surface) -> Paint:
    """A works yard: patched asphalt, oil, rails, weeds at the rim."""
    p, foot = surface.points[:, :2], surface.footprint
    rim = step(50.0, 58.0, p.abs().amax(dim=1) + 10 * (fbm(p, 12.0, 4, 408) - 0.5))
    rail = ((p[:, 1] + 27).abs() - 0.75).abs() < 0.09
    bed = step(2.2, 1.8, (p[:, 1] + 27).abs())
    oil = step(0.60, 0.68, fbm(p, 6.0, 5, 409, foot))
    return Paint(albedo=layered(surface, [
        (None, asphalt_colour), (0.6 * oil, plain("2e2c2a")), (bed, gravel_colour),
        (0.9 * rail.float(), plain("6d5a4c")), (rim, grass_colour),
    ]))  # fmt: skip


def pond_bed(x: Array, y: Array) -> Array:
    """Height of flat lawns with the pond's hollow and low mounds, in metres.

    Args:
        x: Places in metres.
        y: Places in metres, one for each of `x`.
    """
    shore = np.hypot(x - 12, y - 6) - 13
    mounds = 1.2 * np.sin(0.07 * x) * np.cos(0.08 * y) * np.clip(shore / 12, 0, 1)
    return mounds * np.clip(np.hypot(x + 14, y + 4) / 10 - 1, 0, 1) + 1.3 * np.clip(
        shore / 3, -1, 0
    )


def near(lines: list[Line], x: Number, y: Number, reach: Number) -> bool:
    """Whether a place lies near any of some lines.

    Args:
        lines: Corners (x, y) of each line in metres.
        x: The place in metres.
        y: The place in metres.
        reach: Metres below which it is near.
    """
    p = torch.tensor([[x, y]], dtype=torch.float32)
    return min(float(segment_distance(p, line)[0][0]) for line in lines) < reach


def park(surface: Surface) -> Paint:
    """Lawns with walks and a pond's bank."""
    p = surface.points[:, :2]
    edge = fbm(p, 2.5, 3, 410) - 0.5
    away = torch.stack([segment_distance(p, walk)[0] for walk in WALKS]).amin(dim=0)
    shore = (p - p.new_tensor([12.0, 6.0])).norm(dim=1) - 13
    beds = step(0.67, 0.70, fbm(p, 11.0, 2, 411))
    return Paint(albedo=layered(surface, [
        (None, grass_colour), (beds, flowers), (step(1.9, 1.7, away + 0.5 * edge), gravel_colour),
        (step(1.0, 0.0, shore + edge), plain("6b5d45")),
    ]))  # fmt: skip


def flowers(surface: Surface) -> Float[Tensor, "n 3"]:
    """Flower beds in patches of colour."""
    p, foot = surface.points[:, :2], surface.footprint
    hue = fbm(p, 3.0, 3, 412)
    colour = mix(rgb("a8434f"), rgb("d9b548"), step(0.42, 0.58, hue))
    return mix(colour, rgb("3f5a26"), step(0.48, 0.58, fbm(p, 0.6, 3, 413, foot)))
