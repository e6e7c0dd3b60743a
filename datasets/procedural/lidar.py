"""A spinning LiDAR: its pattern of beams, range noise and drop-outs, against the true world."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number

BEAMS = 64
LOW, HIGH = -25.0, 3.0
"""Elevation of the lowest and highest beam in degrees."""
REACH = 75.0
"""Metres beyond which nothing comes back."""
NOISE = 0.015
"""Standard deviation of a range in metres."""
LOST = 0.03
"""Share of returns that are lost anywhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """One turn of the LiDAR."""

    points: Float[np.ndarray, "n 3"]
    """World positions with range noise, metres."""
    ranges: Float[np.ndarray, " n"]
    """True ranges in metres."""
    beams: Int[np.ndarray, " n"]
    azimuths: Float[np.ndarray, " n"]
    """Radians, counter-clockwise from ahead."""
    objects: Int[np.ndarray, " n"]


def sweep(
    caster: Caster, eye: Float[np.ndarray, "3"], heading: Number, columns: int, seed: int
) -> Sweep:
    """Everything that comes back in one turn from a sensor at `eye`.

    Beams stand denser near the horizon, as on real sensors. Returns are lost at grazing
    incidence, with distance, and a few at random.

    Args:
        caster: The world at the moment of the sweep.
        eye: Sensor's place in metres.
        heading: Where the sensor's ahead is, in radians counter-clockwise from +x.
        columns: Firings a turn.
        seed: Decides noise and losses.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 41)))
    share = np.linspace(0, 1, BEAMS)
    elevation = np.radians(HIGH + (LOW - HIGH) * share**1.3)
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    beam, column = (
        x.ravel() for x in np.meshgrid(np.arange(BEAMS), np.arange(columns), indexing="ij")
    )
    angle = azimuth[column] + heading
    flat = np.cos(elevation[beam])
    ways = np.stack([flat * np.cos(angle), flat * np.sin(angle), np.sin(elevation[beam])], axis=1)
    hits = caster.first(np.broadcast_to(eye, ways.shape), ways)
    incidence = np.abs(np.einsum("ij,ij->i", caster.face_normals[hits.face], ways))
    back = (hits.face >= 0) & (hits.distance < REACH) & _kept(hits.distance, incidence, rng)
    true = hits.distance[back]
    noisy = true + rng.normal(0, NOISE, len(true))
    return Sweep(
        points=eye + ways[back] * noisy[:, None], ranges=true, beams=beam[back],
        azimuths=azimuth[column[back]], objects=caster.world.face_objects[hits.face[back]],
    )  # fmt: skip


def _kept(
    distance: Float[np.ndarray, " n"], incidence: Float[np.ndarray, " n"], rng: np.random.Generator
) -> Bool[np.ndarray, " n"]:
    """Which returns are strong enough, by chance: energy falls with range and grazing angle."""
    reach = np.where(np.isfinite(distance), distance, 0)
    chance = (1 - LOST) * np.clip(incidence / 0.08, 0, 1) * np.clip(1.25 - reach / REACH, 0, 1)
    return rng.random(len(distance)) < chance
