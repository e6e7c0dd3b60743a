"""A rock tunnel that a rig of six cameras drives through; its own LED array is the only light."""

from dataclasses import asdict, dataclass, replace
from threading import Lock

import numpy as np
import torch
from jaxtyping import Float

from splatproof.datasets.procedural import things
from splatproof.datasets.procedural.facades import Planks, Solid
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.grounds import gravel_colour, plain
from splatproof.datasets.procedural.lamps import Lamps
from splatproof.datasets.procedural.noise import fbm
from splatproof.datasets.procedural.plan import Plan, Shot, Stage, object_seeds
from splatproof.datasets.procedural.rock import tunnel_rock
from splatproof.datasets.procedural.shapes import (
    Shape,
    box,
    cylinder,
    joined,
    placed,
    polygon,
    smooth,
)
from splatproof.datasets.procedural.surface import Paint, Surface, layered, step
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number
from splatproof.datasets.procedural.vectors import norm
from splatproof.datasets.procedural.world import Builder, World

HALF_WIDTH, SPRING = 2.4, 1.9
"""Half the width, and the height at which walls become the arch, in metres."""
RIG = ((0.0, 0.0), (65.0, 5.0), (-65.0, 5.0), (0.0, 55.0), (100.0, 38.0), (-100.0, 38.0))
"""Yaw to the left and pitch upwards of the six cameras, degrees."""
EYE = 1.55
"""Height of the rig in metres."""
SECONDS = 1.0
"""Time from one stop to the next."""
RELIT = "relit"
"""Group of test views under lamps that stand elsewhere."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Length of the drive and size of the pictures."""

    length: float = 4.0
    """Metres that are driven."""
    stop: float = 0.5
    """Metres between stops (Source: the rig of DLG-GS, Sec. 3.1)."""
    width: int = 224
    height: int = 128
    relit: int = 6
    """Views under other lamps."""
    grid: float = 0.16
    """Metres between vertices of the rock."""
    samples: int = 2


PRESETS = {
    "small": Settings(),
    "medium": Settings(length=40.0, width=480, height=272, relit=40, grid=0.12),
    "large": Settings(length=200.0, width=1920, height=1080, relit=200, grid=0.08, samples=3),
}


def centre(s: Float[np.ndarray, " n"] | float) -> Float[np.ndarray, "n 3"]:
    """Middle of the floor after s metres."""
    s = np.atleast_1d(np.asarray(s, dtype=float))
    return np.stack([s, 2.5 * np.sin(s / 17.0), 0.15 * np.sin(s / 9.0)], axis=1)


def frame(s: Number) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Unit vectors ahead and to the left at s."""
    ahead = centre(s + 0.05)[0] - centre(s - 0.05)[0]
    ahead[2] = 0
    ahead /= norm(ahead)
    return ahead, np.array([-ahead[1], ahead[0], 0.0])


def profile(t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """The tunnel's outline (left, up), t from 0 (right foot) over the crown to 1 (left foot)."""
    arch = np.pi * HALF_WIDTH
    whole = 2 * SPRING + arch
    d = t * whole
    angle = np.clip((d - SPRING) / HALF_WIDTH, 0, np.pi)
    left = -HALF_WIDTH * np.cos(angle)
    up = np.where(d < SPRING, d, np.where(d > SPRING + arch, whole - d, SPRING))
    return np.stack([left, up + HALF_WIDTH * np.sin(angle)], axis=1)


def build(seed: int, settings: Settings) -> World:
    """The tunnel of one seed.

    Args:
        seed: Another seed makes other rock and puts other things on the floor.
        settings: Length of the drive, and how fine the rock is.
    """
    rng = np.random.Generator(np.random.PCG64((seed, 21)))
    world = Builder()
    start, end = -3.0, settings.length + 12.0
    stations = np.arange(start, end, settings.grid)
    around = np.linspace(0, 1, int((2 * SPRING + np.pi * HALF_WIDTH) / settings.grid))
    section = profile(around)
    rings = []
    for s in stations:
        middle, (_, left) = centre(s)[0], frame(float(s))
        rings.append(middle + section[:, :1] * left + section[:, 1:] * np.array([0, 0, 1.0]))
    points = np.stack(rings)
    inner = np.stack([centre(s)[0] + np.array([0, 0, SPRING]) for s in stations])[:, None]
    out = points - inner
    out /= np.linalg.norm(out, axis=2, keepdims=True)
    points = points + out * _bulge(points, seed)[..., None]
    # both ends taper to a face of rock
    for index in range(6):
        for ring in (index, len(points) - 1 - index):
            share = (6 - index) / 6
            points[ring] = inner[ring] + (points[ring] - inner[ring]) * (1 - share**3)
    world.add("rock", [(_grid(points), tunnel_rock)])
    for s in (start + 0.9, end - 0.9):  # what the taper leaves open at the foot
        middle, (_, left) = centre(s)[0], frame(s)
        corners = [middle + u * left + [0, 0, v] for u, v in ((-4, -1), (4, -1), (4, 5), (-4, 5))]
        world.add("rock", [(polygon(np.array(corners)), tunnel_rock)])
    floor = np.stack([centre(s)[0] + np.linspace(-3.2, 3.2, 40)[:, None] * frame(float(s))[1]
                      for s in stations])  # fmt: skip
    floor[..., 2] += _bumps(floor.reshape(-1, 3)[:, :2], seed).reshape(floor.shape[:2])
    world.add("floor", [(_grid(floor), floor_paint)])
    _fittings(world, settings, rng)
    _debris(world, settings, seed, rng)
    return world.build()


def _bumps(places: Float[np.ndarray, "n 2"], seed: int) -> Float[np.ndarray, " n"]:
    """How high the floor stands over the tunnel's middle line, metres."""
    return 0.35 * (fbm(torch.from_numpy(places).float(), 1.6, 5, 521 + seed).numpy() - 0.5)


def _bulge(points: Float[np.ndarray, "a b 3"], seed: int) -> Float[np.ndarray, "a b"]:
    """How far the rock stands back behind the outline, metres."""
    p = torch.from_numpy(points.reshape(-1, 3)).float()
    blocks = fbm(p, 2.2, 5, 522 + seed)
    ledges = (fbm(p, 1.0, 3, 523 + seed) - 0.5).abs()
    return (1.3 * (blocks - 0.45) - 0.9 * ledges + 0.15).numpy().reshape(points.shape[:2])


def _grid(points: Float[np.ndarray, "a b 3"]) -> Shape:
    """A smooth-shaded surface over a grid of points."""
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = [np.stack(x, axis=2).reshape(-1, 3) for x in ((a, b, c), (a, c, d))]
    return smooth(points.reshape(-1, 3), np.concatenate(faces))


def floor_paint(surface: Surface) -> Paint:
    """Muck, tyre tracks and puddles."""
    p, foot = surface.points[:, :2], surface.footprint
    middle = 2.5 * torch.sin(p[:, 0] / 17.0)
    track = step(
        0.3, 0.18, ((p[:, 1] - middle).abs() - 0.75).abs() + 0.3 * (fbm(p, 0.8, 3, 524) - 0.5)
    )
    puddle = step(0.56, 0.58, fbm(p, 3.0, 3, 525))
    colour = layered(surface, [
        (None, gravel_colour), (0.5 * track, plain("4a443c")), (0.75 * puddle, plain("2b2a27")),
    ])  # fmt: skip
    wet = fbm(p, 1.0, 2, 526, foot)
    return Paint(albedo=colour, gloss=puddle * (0.3 + 0.4 * wet))


def _fittings(world: Builder, settings: Settings, rng: np.random.Generator) -> None:
    """A pipe, cable trays, steel ribs."""
    steel, pipe = Solid(tone="6b5a4e", dirt=0.9), Solid(tone="b08a2e", dirt=0.5)
    pieces, trays = [], []
    for s in np.arange(-2.0, settings.length + 10.0, 1.0):
        ahead, left = frame(float(s))
        heading = float(np.arctan2(ahead[1], ahead[0]))
        at = centre(float(s))[0]
        pieces.append(placed(box((1.02, 0.18, 0.18)), at + left * 1.95 + [0, 0, 0.75], heading))
        trays.append(placed(box((1.02, 0.3, 0.05)), at - left * 1.9 + [0, 0, 2.1], heading))
    world.add("pipe", [(joined(*pieces), pipe)])
    world.add("tray", [(joined(*trays), steel)])
    for s in np.arange(1.0, settings.length + 8.0, 6.5):
        ahead, left = frame(float(s))
        outline = profile(np.linspace(0.02, 0.98, 40))
        corners = []  # a steel section of 16 x 20 cm, swept along the outline
        for depth, shift in (
            (0.86, -0.08),
            (0.95, -0.08),
            (0.95, 0.08),
            (0.86, 0.08),
            (0.86, -0.08),
        ):
            u, z = (outline * [depth, 0.5 * (1 + depth)]).T
            corners.append(
                centre(float(s))[0] + u[:, None] * left + z[:, None] * [0, 0, 1.0] + shift * ahead
            )
        world.add("rib", [(_grid(np.stack(corners, axis=1)), steel)])


def _debris(world: Builder, settings: Settings, seed: int, rng: np.random.Generator) -> None:
    """Boxes, drums and boulders that stand on the floor."""
    for _ in range(int((settings.length + 6) / 4)):
        s, side = rng.uniform(0, settings.length + 6), rng.choice([-1.0, 1.0])
        at = centre(float(s))[0] + frame(float(s))[1] * side * rng.uniform(1.3, 1.9)
        # as deep as the floor lies anywhere around
        around = at[:2] + 0.35 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        at[2] += _bumps(around, seed).min()
        if rng.random() < 0.45:
            size = (rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.7))
            world.add("box", [(placed(box(size), at, rng.uniform(0, 3)), Planks(tone="8a6a3e"))])
        elif rng.random() < 0.4:
            drum = placed(cylinder(0.3, 0.88, 18), at)
            world.add("drum", [(drum, Solid(tone="2f5f86", dirt=0.6))])
        else:
            boulder = things.blob((0.45, 0.35, 0.3), 0.3, int(rng.integers(1 << 30)), 2)
            world.add("boulder", [(placed(boulder, at + [0, 0, 0.1]), tunnel_rock)])


def _lamps(caster: Caster, s: Number, offset: Float[np.ndarray, "3"]) -> Lamps:
    """The rig's LED array, moved by `offset` (ahead, left, up) metres."""
    ahead, left = frame(s)
    up = np.array([0, 0, 1.0])
    eye = centre(s)[0] + up * EYE + np.stack([ahead, left, up], axis=1) @ offset
    positions, axes = [], []
    for yaw, pitch in RIG:
        way = _direction(s, yaw, pitch)
        positions.append(eye + 0.25 * way - 0.22 * up)
        axes.append(way)
    return Lamps(caster=caster, positions=np.stack(positions), axes=np.stack(axes), power=5.0)


def _direction(s: Number, yaw: Number, pitch: Number) -> Float[np.ndarray, "3"]:
    """Unit vector of a rig's angle (degrees) at s."""
    ahead, left = frame(s)
    a, b = np.radians(yaw), np.radians(pitch)
    flat = np.cos(a) * ahead + np.sin(a) * left
    return np.cos(b) * flat + np.sin(b) * np.array([0, 0, 1.0])


def _relit_offset(index: int) -> Float[np.ndarray, "3"]:
    """Where the lamps stand for a relit view: behind, ahead, or at either wall."""
    places = ((-2.0, 0.0, 0.3), (1.6, 0.0, 0.2), (0.0, 1.1, -0.4), (0.0, -1.1, 0.5))
    return np.array(places[index % len(places)])


def plan(seed: int, settings: Settings) -> Plan:
    """The whole scene of a seed.

    Args:
        seed: Another seed makes another tunnel; 0 or more.
        settings: Length of the drive and size of the pictures.
    """
    world = build(seed, settings)
    size, focal = (settings.width, settings.height), 0.64 * settings.width  # 23 mm on 36 mm
    found, lights = [], {}
    for stop, s in enumerate(np.arange(0.0, settings.length, settings.stop)):
        eye = centre(float(s))[0] + np.array([0, 0, EYE])
        for index, (yaw, pitch) in enumerate(RIG):
            way = _direction(float(s), yaw, pitch)
            camera = looking(eye + 0.15 * way, eye + way, size, focal)
            name = f"stop_{stop:04d}_camera_{index}.png"
            found.append(
                Shot(name=name, camera=camera, time=SECONDS * stop, sensor=f"camera_{index}")
            )
            lights["", name] = (float(s), np.zeros(3))
    tests = found[::8]
    for index in range(min(settings.relit, len(tests))):
        shot = tests[index * len(tests) // settings.relit]
        name = shot.name.replace(".png", "_relit.png")
        found.append(replace(shot, name=name, group=RELIT))
        lights[RELIT, name] = (lights["", shot.name][0], _relit_offset(index))
    lock, made = Lock(), []

    def stage(shot: Shot) -> Stage:
        with lock:
            if not made:
                made.append(Caster(world))
        s, offset = lights[shot.group, shot.name]
        return Stage(
            caster=made[0], lighting=_lamps(made[0], s, offset), exposure=1.0,
            object_seeds=object_seeds(len(world.kinds), seed),
        )  # fmt: skip

    relit = {
        f"lamps_{name}": " ".join(f"{x:g}" for x in lights[group, name][1])
        for group, name in lights
        if group == RELIT
    }
    return Plan(
        world="tunnel", settings=asdict(settings), seed=seed, shots=tuple(found), stage=stage,
        samples=settings.samples, features=500, kinds={"": world.kinds}, driven=True,
        facts={"relit": "views in the folder relit: the same cameras, lamps moved by lamps_<view> "
               "metres (ahead, left, up)", **relit},
    )  # fmt: skip
