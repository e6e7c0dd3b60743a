"""The ground of a city: its streets, what lies inside its blocks, and the land around it."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural.grounds import (
    asphalt_colour,
    grass_colour,
    gravel_colour,
    paving_colour,
    plain,
)
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.surface import Paint, Surface, layered, step

PITCH = 56.0
"""Metres from street to street."""
ROAD = 5.0
"""Half-width of a carriageway in metres."""
WALK = 2.6
"""Width of a pavement in metres."""
RIVER = 24.0
"""Width of the river that runs along the last row of blocks, in metres."""
KINDS = ("slabs", "old town", "offices", "park", "parking", "villas")
"""What a block can be; each has its own density of detail."""
Kinds = tuple[tuple[int, ...], ...]
"""Index into KINDS for each block, by column (x) and row (y)."""


@dataclass(frozen=True)
class CityGround:
    """Streets between blocks and what lies inside them."""

    kinds: Kinds
    """What stands on each block."""

    def __call__(self, surface: Surface) -> Paint:
        """Colour."""
        p = surface.points[:, :2]
        table = torch.tensor(self.kinds)
        size = torch.tensor([table.shape[0], table.shape[1]])
        grid = p / PITCH + size / 2
        cell = grid.floor()
        local = (grid - cell - 0.5) * PITCH
        column = cell.long().clamp(min=torch.zeros(2, dtype=torch.long), max=size - 1)
        kind = table[column[:, 0], column[:, 1]]
        # distance to the nearest street's middle on each axis
        away = PITCH / 2 - local.abs()
        outside = ((p.abs() - PITCH * size / 2).amax(dim=1) - ROAD).clamp(min=0)
        street = away.amin(dim=1)
        edge = 0.5 * (fbm(p, 1.7, 3, 301) - 0.5)
        along = torch.where(away[:, 0] < away[:, 1], p[:, 1], p[:, 0])
        crossing = away.amax(dim=1) < ROAD + WALK
        dash = (street < 0.12) & (torch.remainder(along / 6, 1) < 0.5) & ~crossing
        zebra = (
            (away.amax(dim=1) > ROAD + 0.6)
            & (away.amax(dim=1) < ROAD + 3.2)
            & (street < ROAD - 0.4)
        ) & (torch.remainder(torch.where(away[:, 0] < away[:, 1], p[:, 0], p[:, 1]), 1.1) < 0.55)
        inner = [
            (step(0.60, 0.66, fbm(p, 9.0, 3, 302)) * (kind != 4).float(), gravel_colour),
            ((kind == 1).float(), cobbles),
            ((kind == 2).float(), plaza),
            ((kind == 4).float(), parking),
            (step(0.5, 0.45, self._paths(local) + edge) * (kind == 3).float(), gravel_colour),
        ]
        road = step(ROAD + 0.02, ROAD - 0.02, street)
        walk = step(ROAD + WALK + 0.05, ROAD + WALK, street)
        kerb = ((street - ROAD).abs() < 0.16).float()
        city = (outside == 0).float()
        return Paint(
            albedo=layered(
                surface,
                [
                    (None, grass_colour),
                    *((share * city, paint) for share, paint in inner),
                    (walk * city, pavement),
                    (kerb * city, plain("b4b0a8")),
                    (road * city, asphalt_colour),
                    (0.8 * dash.float() * city, plain("d6d4cc")),
                    (0.75 * zebra.float() * city, plain("dcdad2")),
                ],
            )
        )

    @staticmethod
    def _paths(local: Float[Tensor, "n 2"]) -> Float[Tensor, " n"]:
        """A park's paths: 0 on a winding cross and a ring, growing away from them."""
        radius = local.norm(dim=1)
        ring = (radius - 11).abs() / 2.2
        cross = (local[:, 0] - 4 * torch.sin(local[:, 1] / 7)).abs() / 2.2
        return torch.minimum(
            ring, torch.minimum(cross, (local[:, 1] + local[:, 0] * 0.3).abs() / 2.2)
        )


def cobbles(surface: Surface) -> Float[Tensor, "n 3"]:
    """Setts of an old town."""
    return paving_colour(surface, (0.5, 0.5), "8f8678")


def plaza(surface: Surface) -> Float[Tensor, "n 3"]:
    """Large slabs between office buildings."""
    return paving_colour(surface, (1.6, 1.6), "b3aca0")


def pavement(surface: Surface) -> Float[Tensor, "n 3"]:
    """Concrete slabs of a pavement."""
    return paving_colour(surface, (0.8, 0.8), "9c9890")


def parking(surface: Surface) -> Float[Tensor, "n 3"]:
    """Asphalt with bays 2.5 m wide."""
    p = surface.points[:, :2]
    row = torch.remainder(p[:, 1], 16.0)
    line = (torch.remainder(p[:, 0], 2.5) < 0.14) & ((row < 5) | (row > 11))
    return layered(surface, [(None, asphalt_colour), (0.85 * line.float(), plain("d8d6cf"))])


def height(
    x: Float[np.ndarray, "..."],
    y: Float[np.ndarray, "..."],
    half: Float[np.ndarray, "2"],
    river: bool,
) -> Float[np.ndarray, "..."]:
    """Flat city, a river bed beyond its last row, hills around. Metres.

    Args:
        x: Places in metres.
        y: Places in metres, one for each of `x`.
        half: Half of the city's extent along x and y, in metres.
        river: Whether a river runs along the last row of blocks.
    """
    out = np.maximum(np.abs(x) - half[0], np.abs(y) - half[1])
    hills = 7 * (np.sin(0.031 * x + 1) + np.cos(0.027 * y)) + 3 * np.sin(0.09 * x - 0.07 * y) + 6
    if not river:
        return hills * np.clip((out - 14) / 60, 0, 1)
    bank = (y - half[1] - 12) / RIVER
    bed = np.clip(1 - (2 * bank - 1) ** 4, 0, 1) * ((bank > 0) & (bank < 1))
    rise = np.where(y > half[1], (bank - 1).clip(min=0) * RIVER, out - 14)
    return hills * np.clip(rise / 60, 0, 1) - 3.0 * bed
