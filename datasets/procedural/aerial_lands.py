"""Open land around the small aerial scenes, farther than any view looks, with its trees and woods."""

from collections.abc import Callable

import numpy as np
import torch

from splatproof.datasets.procedural.blocks import tree
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.shapes import heightfield
from splatproof.datasets.procedural.surface import Material
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.world import Builder

NEAR, FAR = 110.0, 320.0
"""Half-sides of the land in metres: where its grid is fine, and where it ends."""
COARSE = 10.0
"""Metres between grid lines beyond NEAR."""

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Metres over x and y."""
Taken = Callable[[Number, Number], bool]
"""Whether no tree may stand at x, y."""


def meadow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of land that is flat in the middle, with low waves outside, in metres.

    Args:
        x: Places in metres.
        y: Places in metres, one for each of `x`.
    """
    return 0.5 * np.sin(0.05 * x) * np.cos(0.06 * y) * np.clip(np.hypot(x, y) / 60 - 0.6, 0, 1)


def ground(
    world: Builder, material: Material, heights: Heights = meadow, step: Number = 4.0
) -> None:
    """Add the land of a scene.

    Args:
        world: Gets the land.
        material: What it looks like.
        heights: How high it lies.
        step: Metres between its grid lines in the middle.
    """
    outer = np.arange(NEAR + COARSE, FAR + COARSE / 2, COARSE)
    axis = np.concatenate([-outer[::-1], np.arange(-NEAR, NEAR + step / 2, step), outer])
    world.add("ground", [(heightfield(axis, axis, heights(*np.meshgrid(axis, axis))), material)])


def around(
    world: Builder,
    rng: np.random.Generator,
    count: int,
    beyond: Number,
    taken: Taken,
    heights: Heights = meadow,
) -> None:
    """Add trees around the middle, fewer and fewer outwards.

    Args:
        world: Gets the trees.
        rng: Draws their places, kinds and sizes.
        count: How many are tried; those on taken ground or beyond NEAR are dropped.
        beyond: Metres from the middle within which none stands.
        taken: Where none may stand.
        heights: How high the ground lies.
    """
    for _ in range(count):
        angle, radius = rng.uniform(0, 2 * np.pi), beyond + rng.exponential(16.0)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        if radius < NEAR and not taken(x, y):
            tree(world, x, y, rng, float(heights(np.array([x]), np.array([y]))[0]))


def woods(
    world: Builder,
    seed: int,
    heights: Heights = meadow,
    taken: Taken = lambda x, y: False,
) -> None:
    """Add the woods beyond NEAR.

    Args:
        world: Gets the trees.
        seed: Decides their places, kinds and sizes.
        heights: How high the ground lies.
        taken: Where no tree may stand.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 16)))
    places = rng.uniform(-250, 250, (420, 2))
    wooded = fbm(torch.from_numpy(places).float(), 40.0, 2, 303).numpy() > 0.5
    places = places[wooded & (np.hypot(*places.T) > NEAR)]
    for (x, y), z in zip(places, heights(*places.T), strict=True):
        if not taken(x, y):
            tree(world, x, y, rng, float(z), detail=1)
