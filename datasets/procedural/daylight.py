"""Sun and sky: shadow rays for the sun, a volume of precomputed sky light for the rest."""

from copy import copy
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.procedural.noise import fbm, inner
from splatproof.datasets.procedural.surface import mix, rgb, step
from splatproof.datasets.procedural.tracing import START, Caster
from splatproof.datasets.procedural.units import Number, Triple

DIRECTIONS = 64
"""Rays by which each cell of the volume looks around."""
BOUNCE = 0.16
"""Radiance of what is not sky, as seen from the volume: sunlit ground of middling albedo."""
CELLS_AT_ONCE = 4096
FILLS = 4
"""Cells by which known light spreads into solids."""


@dataclass(frozen=True, kw_only=True)
class Sky:
    """Where the sun stands and how bright things are (linear, 1 is a white in full sun)."""

    azimuth: float = 2.2
    """Radians, counter-clockwise from +x."""
    elevation: float = 0.85
    """Radians above the horizon."""
    sun: tuple[float, float, float] = (0.86, 0.80, 0.70)
    """Irradiance over pi of a surface that faces the sun."""
    ambient: tuple[float, float, float] = (0.26, 0.31, 0.38)
    """Mean radiance of the sky."""
    clouds: float = 0.4
    """Share of the sky that clouds cover, in [0, 1]."""

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector to the sun."""
        c = np.cos(self.elevation)
        return np.array(
            [c * np.cos(self.azimuth), c * np.sin(self.azimuth), np.sin(self.elevation)]
        )

    def picture(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """What the sky looks like in each unit direction; a flat haze below the horizon."""
        up = directions[:, 2].clamp(min=0)
        blue = mix(rgb("c3d3e2"), rgb("4f7db8"), up**0.5)
        plane = directions[:, :2] / (up + 0.12)[:, None]
        heap = fbm(plane, 1.1, 5, seed=91)
        cover = step(0.62 - 0.25 * self.clouds, 0.78 - 0.25 * self.clouds, heap) * step(0, 0.15, up)
        return mix(blue, rgb("eef0f2") * (0.75 + 0.25 * heap)[:, None], cover * 0.9)


def fibonacci(count: int) -> Float[np.ndarray, "n 3"]:
    """Unit vectors spread evenly over the sphere. Source: Gonzalez 2010, Fibonacci lattices."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    angle = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


class Daylight:
    """Light that reaches surfaces: the sun by shadow rays, the sky from a volume."""

    def __init__(self, caster: Caster, sky: Sky, low: Triple,
                 high: Triple, cell: Number):  # fmt: skip
        """Fill a volume with the light of the sky.

        Args:
            caster: The world, which throws shadows and hides parts of the sky.
            sky: Where the sun stands and how bright things are.
            low: Lowest corner of the volume in metres.
            high: Highest corner of the volume in metres.
            cell: Metres between the places where sky light is known, about.
        """
        self.caster, self.sky = caster, sky
        self.low, self.high = np.array(low, dtype=float), np.array(high, dtype=float)
        shape = np.maximum(np.ceil((self.high - self.low) / cell).astype(int), 2)
        self.cell = cell
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, shape, strict=True)]
        centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self.volume = sky_moments(caster, sky, centres.reshape(*shape, 3))

    @classmethod
    def known(cls, caster: Caster, sky: Sky, low: Float[np.ndarray, "3"],
              high: Float[np.ndarray, "3"], cell: Number,
              volume: Float[Tensor, "1 12 x y z"]) -> "Daylight":  # fmt: skip
        """Light whose volume is there already.

        Args:
            caster: The world, which throws shadows.
            sky: Where the sun stands and how bright things are.
            low: Lowest corner of the volume in metres.
            high: Highest corner of the volume in metres.
            cell: Metres between the places where sky light is known.
            volume: Light at these places, as `sky_moments` returns it.
        """
        light = cls.__new__(cls)
        light.caster, light.sky, light.low, light.high = caster, sky, low, high
        light.cell, light.volume = cell, volume
        return light

    def seen_by(self, caster: Caster) -> "Daylight":
        """The same light with the shadows of another world, say with moving things in it."""
        other = copy(self)
        other.caster = caster
        return other

    def background(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Radiance of rays that meet nothing."""
        return self.sky.picture(directions)

    def light(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        normals: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 3"]:
        """Irradiance over pi of sun and sky.

        Args:
            points: Places on surfaces in metres.
            face_normals: Unit normals of the triangles there, towards the viewer.
            normals: Unit shading normals there, towards the viewer.
        """
        to_sun = self.sky.direction
        facing = (face_normals @ to_sun) > 0
        lit = np.zeros(len(points), dtype=bool)
        starts = points[facing] + face_normals[facing] * START * 5
        lit[facing] = ~self.caster.blocked(starts, np.broadcast_to(to_sun, starts.shape))
        cosine = inner(normals, torch.from_numpy(to_sun.astype(np.float32))).clamp(min=0)
        sun = torch.from_numpy(lit).float() * cosine
        return sun[:, None] * torch.tensor(self.sky.sun) + self._skylight(points, normals)

    def _skylight(
        self, points: Float[np.ndarray, "n 3"], normals: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 3"]:
        """Irradiance over pi from sky and surroundings, of degree 1 in the normal."""
        # a little off the surface, so that a wall reads the cells before it, not behind it
        where = torch.from_numpy(points).float() + normals * (0.6 * self.cell)
        low, high = (torch.from_numpy(x).float() for x in (self.low, self.high))
        grid = ((where - low) / (high - low) * 2 - 1).flip(1)
        found = functional.grid_sample(
            self.volume, grid.reshape(1, 1, 1, -1, 3), align_corners=True, padding_mode="border"
        )
        moments = found.reshape(4, 3, -1)
        # cosine lobe in spherical harmonics: pi for degree 0, 2 pi / 3 for degree 1
        value = moments[0] + 2 / 3 * (moments[1:] * normals.T[:, None]).sum(dim=0)
        return value.T.clamp(min=0.01)


def sky_moments(
    caster: Caster, sky: Sky, centres: Float[np.ndarray, "x y z 3"]
) -> Float[Tensor, "1 12 x y z"]:
    """Mean radiance and 3 x its first moments at a grid of places.

    Places inside solids take what their open neighbours have, up to FILLS cells away.

    Args:
        caster: The world, which hides parts of the sky.
        sky: Where the sun stands and how bright things are.
        centres: The places in metres.
    Returns: Channels: RGB of the mean, then RGB of 3 x the moment along x, along y and along z.
    """
    moments, valid = _look_around(caster, sky, centres.reshape(-1, 3))
    shape = centres.shape[:3]
    return _filled(moments.reshape(*shape, 12), valid.reshape(shape))


def _look_around(
    caster: Caster, sky: Sky, centres: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 12"], Bool[np.ndarray, " n"]]:
    """Mean radiance and 3 x its first moments at each place, and whether it is in the open."""
    ways = fibonacci(DIRECTIONS)
    zenith = np.clip(ways[:, 2], 0, 1)[:, None]
    seen_sky = np.array(sky.ambient) * (0.8 + 0.4 * zenith)
    bounce = BOUNCE * np.array([1.0, 0.93, 0.82])
    basis = np.hstack([np.ones((DIRECTIONS, 1)), 3 * ways]) / DIRECTIONS
    moments, valid = [], []
    for start in range(0, len(centres), CELLS_AT_ONCE):
        some = centres[start : start + CELLS_AT_ONCE]
        rays = np.repeat(some, DIRECTIONS, axis=0)
        hits = caster.first(rays, np.tile(ways, (len(some), 1)))
        face = hits.face.reshape(len(some), DIRECTIONS)
        back = (face >= 0) & (np.einsum("nki,ki->nk", caster.plane[face], ways) > 0)
        open_sky = (face < 0) & (ways[:, 2] > 0)
        radiance = np.where(open_sky[..., None], seen_sky, bounce)
        moments.append(np.einsum("nkc,km->nmc", radiance, basis).reshape(len(some), 12))
        valid.append(back.mean(axis=1) < 0.25)  # many backs seen: inside a solid
    return np.concatenate(moments), np.concatenate(valid)


def _filled(moments: Float[np.ndarray, "x y z 12"], valid: Bool[np.ndarray, "x y z"]) -> Tensor:
    """The volume with cells inside solids taking the mean of their open neighbours."""
    value = (
        torch.from_numpy(np.where(valid[..., None], moments, 0)).float().permute(3, 0, 1, 2)[None]
    )
    weight = torch.from_numpy(valid).float()[None, None]
    kernel = torch.ones(1, 1, 3, 3, 3)
    for _ in range(FILLS):
        around = functional.conv3d(value.transpose(0, 1), kernel, padding=1).transpose(0, 1)
        count = functional.conv3d(weight, kernel, padding=1)
        value = torch.where(weight > 0, value, around / count.clamp(min=1))
        weight = torch.where(weight > 0, weight, (count > 0).float())
    return value
