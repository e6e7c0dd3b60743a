"""What moves in a street: cars on paths, people who walk. Poses are functions of time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatproof.datasets.procedural import things
from splatproof.datasets.procedural.facades import Solid
from splatproof.datasets.procedural.shapes import Shape, blob, cylinder, joined, placed
from splatproof.datasets.procedural.things import Parts
from splatproof.datasets.procedural.units import Number

STEP = 1.35
"""Metres that a person walks in one cycle of the legs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mover:
    """One thing that moves."""

    kind: str
    """"moving car" (rigid) or "walker" (not rigid)."""
    parts: Callable[[float], Parts]
    """The thing's shape at a time in seconds, in its own frame: x ahead, origin on the ground."""
    place: Callable[[float], tuple[float, float, float]]
    """x, y in metres and heading in radians at a time in seconds."""

    def pose(self, time: Number) -> Float[np.ndarray, "4 4"]:
        """Motion from the thing's own frame to the world at a time in seconds."""
        x, y, heading = self.place(time)
        c, s = np.cos(heading), np.sin(heading)
        return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])

    def at(self, time: Number) -> Parts:
        """The thing's parts in the world at a time in seconds."""
        x, y, heading = self.place(time)
        return things.moved(self.parts(time), (x, y, 0.0), heading)


def straight(x: Number, y: Number, speed: Number) -> Callable[[float], tuple[float, float, float]]:
    """A path along x.

    Args:
        x: Where it begins along x, in metres.
        y: Where it runs along y, in metres.
        speed: Metres a second; negative: towards -x.
    Returns: Place (x, y in metres) and heading (radians) at a time in seconds.
    """
    return lambda t: (x + speed * t, y, 0.0 if speed >= 0 else np.pi)


def turning(
    x: Number, y: Number, speed: Number, radius: Number, lane: Number
) -> Callable[[float], tuple[float, float, float]]:
    """A path out of the side street, along +y and then through a left-hand bend into -x.

    Args:
        x: Where it begins along x, in metres.
        y: Where it begins along y, in metres.
        speed: Metres a second, above 0.
        radius: Radius of the bend, in metres.
        lane: y of the lane that it turns into, in metres.
    Returns: Place (x, y in metres) and heading (radians) at a time in seconds.
    """

    def place(t: Number) -> tuple[float, float, float]:
        done = speed * t
        ahead = lane - y - radius  # metres of straight street before the bend
        if done < ahead:
            return x, y + done, np.pi / 2
        angle = min((done - ahead) / radius, np.pi / 2)
        past = max(done - ahead - radius * np.pi / 2, 0.0)
        return (x - radius + radius * np.cos(angle) - past, lane - radius + radius * np.sin(angle),
                np.pi / 2 + angle)  # fmt: skip

    return place


def car(paint: str, length: Number, place: Callable[[float], tuple[float, float, float]]) -> Mover:
    """A car that drives.

    Args:
        paint: Colour of the body as an sRGB code.
        length: Metres.
        place: Place (x, y in metres) and heading (radians) at a time in seconds.
    """
    parts = things.car(paint, length)
    return Mover(kind="moving car", parts=lambda t: parts, place=place)


def walker(
    seed: int, x: Number, y: Number, speed: Number, across: bool = False, until: Number = np.inf
) -> Mover:
    """A person who walks along x (or across it, along y) with swinging arms and legs.

    Args:
        seed: Decides looks and gait.
        x: Where the walk begins along x, in metres.
        y: Where the walk begins along y, in metres.
        speed: Metres a second; negative: towards -x or -y.
        across: Whether the person walks along y instead of x.
        until: Seconds after which the person stands still.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 31)))
    tones = ("7a2f35", "2f4a6b", "3d5a45", "8a7a5c", "54486b", "b5a58c")
    coat, trousers = (Solid(tone=str(rng.choice(tones)), dirt=0.5) for _ in range(2))
    skin = Solid(tone="b98a6d", dirt=0.1)
    tall, start = rng.uniform(0.93, 1.06), rng.uniform(0, 2 * np.pi)

    def parts(time: Number) -> Parts:
        swing = 0.55 * np.sin(start + 2 * np.pi * abs(speed) * min(time, until) / STEP)
        legs = [_limb((0.0, side * 0.1, 0.88), swing * side, 0.86, 0.085) for side in (-1, 1)]
        arms = [_limb((0.0, side * 0.27, 1.38), -swing * side, 0.6, 0.055) for side in (-1, 1)]
        torso = placed(blob((0.16, 0.23, 0.36), 0.06, seed, 2), (0, 0, 1.16))
        head = placed(blob((0.11, 0.1, 0.14), 0.03, seed + 1, 2), (0.01, 0, 1.66))
        body = [(joined(torso, *arms), coat), (joined(*legs), trousers), (head, skin)]
        return [(_scaled(shape, tall), material) for shape, material in body]

    heading = (np.pi / 2 if across else 0.0) + (np.pi if speed < 0 else 0.0)

    def place(time: Number) -> tuple[float, float, float]:
        done = speed * min(time, until)
        return (x, y + done, heading) if across else (x + done, y, heading)

    return Mover(kind="walker", parts=parts, place=place)


def _limb(
    joint: tuple[float, float, float], angle: Number, length: Number, radius: Number
) -> Shape:
    """A limb that hangs from a joint, swung ahead by `angle` radians."""
    limb = cylinder(radius * 0.7, length, 10, radius)
    c, s = np.cos(angle), np.sin(angle)
    swing = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    vertices = (limb.vertices - [0, 0, length]) @ swing.T + np.array(joint)
    return Shape(
        vertices=vertices, faces=limb.faces, normals=limb.normals @ swing.T, coords=limb.coords
    )


def _scaled(shape: Shape, factor: Number) -> Shape:
    return Shape(
        vertices=shape.vertices * factor,
        faces=shape.faces,
        normals=shape.normals,
        coords=shape.coords,
    )
