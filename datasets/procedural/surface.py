"""What a texture is asked with and what it answers, and the small maths that textures share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.datasets.procedural.units import Number


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Points on surfaces of one material."""

    points: Float[Tensor, "n 3"]
    """World positions in metres."""
    normals: Float[Tensor, "n 3"]
    """Unit shading normals, towards the viewer."""
    coords: Float[Tensor, "n 4"]
    """Texture coordinates; their meaning is the material's."""
    seeds: Float[Tensor, " n"]
    """A number in [0, 1) that belongs to the object."""
    footprint: Float[Tensor, " n"]
    """Metres between neighbouring samples here."""

    def part(self, rows: Int[Tensor, " k"]) -> "Surface":
        """The points in the given rows."""
        return Surface(
            points=self.points[rows], normals=self.normals[rows], coords=self.coords[rows],
            seeds=self.seeds[rows], footprint=self.footprint[rows],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Paint:
    """How the surface reflects light."""

    albedo: Float[Tensor, "n 3"]
    """Linear diffuse reflectance in [0, 1]."""
    gloss: Float[Tensor, " n"] | None = None
    """Share of the mirror reflection of the sky, in [0, 1]; None: matt."""
    bump: Float[Tensor, "n 3"] | None = None
    """Added to the unit normal before lighting."""


Material = Callable[[Surface], Paint]


def rgb(code: str) -> Tensor:
    """Linear colour of an sRGB code such as "8a7f6b"."""
    values = torch.tensor([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    return to_linear(values)


def to_linear(srgb: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Linear light of sRGB values in [0, 1]. Source: IEC 61966-2-1."""
    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Values in [0, 1] as stored in images, of linear light. Source: IEC 61966-2-1."""
    linear = linear.clamp(0, 1)
    low = linear * 12.92
    return torch.where(
        linear <= 0.0031308, low, 1.055 * linear.clamp(min=1e-8) ** (1 / 2.4) - 0.055
    )


def mix(
    a: Float[Tensor, "*n 3"], b: Float[Tensor, "*m 3"], share: Float[Tensor, " k"]
) -> Float[Tensor, "k 3"]:
    """Colours a (share 0) to b (share 1).

    Args:
        a: Colours, or one for all.
        b: Colours, or one for all.
        share: How much of `b` is in each, in [0, 1].
    """
    return a + (b - a) * share[:, None]


def step(low: Number, high: Number, x: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Smooth step from 0 at `low` to 1 at `high` (falling where low > high).

    Args:
        low: Where the step leaves 0.
        high: Where it reaches 1.
        x: Positions in the unit of both.
    """
    t = ((x - low) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def palette(codes: list[str], choice: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    """One colour of the list for each number in [0, 1).

    Args:
        codes: sRGB codes such as "8a7f6b".
        choice: Numbers in [0, 1); equal parts of that range stand for the codes in their order.
    """
    table = torch.stack([rgb(code) for code in codes])
    return table[(choice * len(codes)).long().clamp(0, len(codes) - 1)]


def layered(
    surface: Surface,
    layers: Sequence[tuple[Float[Tensor, " n"] | None, Callable[[Surface], Float[Tensor, "_ 3"]]]],
) -> Float[Tensor, "n 3"]:
    """Colour of layers on top of each other, bottom first; each is asked only where it shows.

    Args:
        surface: The points.
        layers: Share of what lies below that the layer hides, in [0, 1] (None: all of it), and
            its colour.
    """
    colour = torch.zeros_like(surface.points)
    left = torch.ones_like(surface.seeds)
    for share, paint in reversed(layers):
        weight = left if share is None else left * share
        rows = torch.nonzero(weight > 1 / 1024)[:, 0]
        if len(rows):
            colour[rows] += paint(surface.part(rows)) * weight[rows, None]
        left = left - weight
    return colour
