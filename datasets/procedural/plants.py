"""Textures of trees, hedges and crops."""

from dataclasses import dataclass

import torch

from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.surface import Paint, Surface, mix, palette, rgb, step


@dataclass(frozen=True)
class Leaves:
    """Foliage: bright tips over dark gaps, with a normal that follows clumps of leaves."""

    tones: tuple[str, ...] = ("4e6b2e", "62793a", "3f5c33", "767b3c", "57702f")
    clump: float = 0.9
    """Size of a clump of leaves in metres."""

    def __call__(self, surface: Surface) -> Paint:
        """Colour and bump."""
        p, foot = surface.points, surface.footprint
        clumps = fbm(p, self.clump, 4, 81, foot)
        gap = step(0.50, 0.36, clumps)
        tone = palette(list(self.tones), surface.seeds)
        tip = step(0.52, 0.72, fbm(p, self.clump * 0.45, 3, 82, foot))
        colour = tone * (0.55 + 0.9 * clumps)[:, None]
        colour = mix(colour, tone * 1.9 + rgb("1c1c06"), 0.55 * tip)
        colour = mix(colour, rgb("141c0c"), 0.8 * gap)
        lean = [fbm(p, self.clump, 3, 83 + axis, foot) - 0.5 for axis in range(3)]
        return Paint(albedo=colour, bump=2.2 * torch.stack(lean, dim=1))


@dataclass(frozen=True)
class Bark:
    """Tree trunks."""

    def __call__(self, surface: Surface) -> Paint:
        """Colour."""
        streaks = fbm(surface.points * torch.tensor([1.0, 1.0, 0.2]), 0.4, 4, 86, surface.footprint)
        return Paint(albedo=mix(rgb("3a2f25"), rgb("77685a"), streaks))
