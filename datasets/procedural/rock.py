"""Textures of rock: cliffs and tunnel walls."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.surface import Paint, Surface, mix, rgb, step


def rock_colour(surface: Surface) -> Float[Tensor, "n 3"]:
    """Albedo of a cliff: layers, cracks, lichen."""
    p, foot = surface.points, surface.footprint
    bend = fbm(p, 14.0, 3, 501)
    layer = fbm(torch.stack([p[:, 2] * 0.9 + 6 * bend, p[:, 0] * 0.05], dim=1), 2.6, 4, 502, foot)
    colour = mix(rgb("6f675d"), rgb("a89d8c"), step(0.3, 0.7, layer))
    crack = 1 - step(0.0, 0.05, (fbm(p, 5.0, 5, 503, foot) - 0.5).abs())
    colour = colour * (0.65 + 0.7 * fbm(p, 1.4, 5, 504, foot))[:, None]
    colour = mix(colour, rgb("3a352f"), 0.6 * crack)
    lichen = step(0.60, 0.68, fbm(p, 6.0, 4, 505, foot))
    return mix(colour, rgb("8a8a5e"), 0.4 * lichen)


def tunnel_rock(surface: Surface) -> Paint:
    """Blasted rock under dust: large weakly textured faces, sparse veins, seams and stains."""
    p, foot = surface.points, surface.footprint
    base = mix(rgb("7a746b"), rgb("9a9388"), fbm(p, 3.0, 4, 511, foot))
    rich = step(0.44, 0.60, fbm(p, 9.0, 2, 512))  # elsewhere there is hardly any texture
    grain = fbm(p, 0.5, 5, 513, foot) - 0.5
    fine = fbm(p, 0.12, 3, 520, foot) - 0.5
    colour = base * (1 + (0.55 + 1.3 * rich) * grain + (0.45 + 0.6 * rich) * fine)[:, None]
    vein = 1 - step(0.0, 0.035, (fbm(p, 4.0, 4, 514, foot) - 0.5).abs())
    colour = mix(colour, rgb("c9c0ae"), 0.65 * vein * rich)
    damp = step(0.58, 0.66, fbm(p * torch.tensor([1.0, 1.0, 0.3]), 3.5, 4, 515, foot))
    colour = mix(colour, colour * 0.45, damp)
    rust = step(0.66, 0.72, fbm(p, 2.2, 4, 516, foot)) * rich
    lean = [fbm(p, 0.5, 5, 517 + axis, foot) - 0.5 for axis in range(3)]
    return Paint(albedo=mix(colour, rgb("7d4f30"), 0.6 * rust), gloss=0.25 * damp,
                 bump=1.5 * torch.stack(lean, dim=1))  # fmt: skip
