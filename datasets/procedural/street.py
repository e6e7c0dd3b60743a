"""A drive down a street: three front cameras, moving cars and people, a LiDAR, and other lanes' views."""

import io
from collections import OrderedDict
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock

import numpy as np
import torch

from splatbench.datasets.files import write_bytes
from splatbench.datasets.procedural import lidar, things, traffic
from splatbench.datasets.procedural.blocks import parked_car, tree
from splatbench.datasets.procedural.city import pavement
from splatbench.datasets.procedural.daylight import Daylight, Sky
from splatbench.datasets.procedural.facades import Facade, Solid, stones
from splatbench.datasets.procedural.flights import looking
from splatbench.datasets.procedural.grounds import asphalt_colour, grass_colour, plain
from splatbench.datasets.procedural.noise import fbm
from splatbench.datasets.procedural.plan import Plan, Shot, Stage, object_seeds
from splatbench.datasets.procedural.shapes import box, cylinder, joined, placed, polygon
from splatbench.datasets.procedural.surface import Paint, Surface, layered, mix, palette, rgb, step
from splatbench.datasets.procedural.tracing import Caster
from splatbench.datasets.procedural.units import Number
from splatbench.datasets.procedural.world import Builder

CARRIAGE, WALK = 6.6, 3.4
"""Half-width of the carriageway and width of each pavement in metres."""
CROSSING = 34.0
"""Where the side street crosses, metres along the street."""
CAMERAS = {"front": 0.0, "left": 42.0, "right": -42.0}
"""Yaw of the cameras to the left in degrees."""
RATE = 10.0
"""Frames a second."""
SHIFTED = "lane_shift"
"""Group of the views from other lanes."""
SHIFTS = (-1.5, 2.0, 3.5)
"""Metres to the left at which those views are taken."""
HELD = 4
"""Every HELD-th frame is meant for tests."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How long is driven and what is recorded."""

    frames: int = 12
    width: int = 240
    height: int = 160
    speed: float = 8.5
    """Metres a second."""
    shifted: int = 2
    """Frames that are also seen from other lanes, by all cameras."""
    columns: int = 450
    """LiDAR firings a turn."""
    cell: float = 2.5
    samples: int = 3


PRESETS = {
    "small": Settings(),
    "medium": Settings(frames=50, width=480, height=320, shifted=8, columns=1030),
    "large": Settings(frames=200, width=1920, height=1280, shifted=24, columns=2083, samples=4),
}


def ground(surface: Surface) -> Paint:
    """Carriageway, crossing, pavements, gardens behind the houses."""
    p = surface.points[:, :2]
    main, side = p[:, 1].abs(), (p[:, 0] - CROSSING).abs()
    half_side = 4.5
    on_main, on_side = (
        step(CARRIAGE + 0.02, CARRIAGE, main),
        step(half_side + 0.02, half_side, side),
    )
    road = 1 - (1 - on_main) * (1 - on_side)
    walk = torch.maximum(step(CARRIAGE + WALK + 0.1, CARRIAGE + WALK, main),
                         step(half_side + 2.4, half_side + 2.3, side))  # fmt: skip
    middle = (side > half_side + 2).float()
    dash = ((main < 0.08) | ((main - 3.3).abs() < 0.06)) & (
        torch.remainder(p[:, 0] / 4.5, 1) < 0.55
    )
    stripes = torch.remainder(p[:, 1], 1.1) < 0.55
    zebra = ((side - half_side - 3.0).abs() < 1.5) & stripes & (main < CARRIAGE - 0.5)
    kerb = ((main - CARRIAGE).abs() < 0.12) & (side > half_side)
    drain = ((main - CARRIAGE + 0.5).abs() < 0.22) & (torch.remainder(p[:, 0], 14.0) < 0.5)
    return Paint(albedo=layered(surface, [
        (None, grass_colour), (walk, pavement), (road, asphalt_colour),
        (0.8 * dash.float() * middle, plain("d8d6ce")), (0.8 * zebra.float(), plain("dddbd4")),
        (kerb.float(), plain("b5b1a9")), (drain.float(), plain("2a2a2b")),
    ]))  # fmt: skip


def shopfront(surface: Surface) -> Paint:
    """Ground floors with shop windows; coords are (u, v, width, height)."""
    u, v, width, _ = surface.coords.unbind(dim=1)
    bay = width / (width / 3.6).floor().clamp(min=1)
    x = u - ((u / bay).floor() + 0.5) * bay
    pane = (x.abs() < bay / 2 - 0.3) & (v > 0.55) & (v < 2.6) & ((x.abs() - 0.6).abs() > 0.04)
    sign = (v > 2.8) & (v < 3.3)
    plane = torch.stack([u + 31 * surface.seeds, v], dim=1)
    foot = surface.footprint
    goods = fbm(plane * torch.tensor([1.0, 1.4]), 0.9, 5, 601, foot)
    tone = palette(["3f4a44", "5b3a33", "2f3c52", "6a6358", "4a4440"], surface.seeds)
    board = palette(["c9b58a", "8c2f2b", "2f5a48", "d6d2c6"], torch.remainder(5 * surface.seeds, 1))
    shelf = (torch.remainder(v, 0.55) < 0.05).float()
    inside = mix(rgb("15181b"), rgb("8c7a64"), step(0.42, 0.75, goods) * (1 - shelf))
    letters = step(0.52, 0.56, fbm(plane * torch.tensor([2.2, 0.8]), 0.5, 2, 602, foot))
    colour = tone * (0.75 + 0.5 * fbm(plane, 1.0, 4, 603, foot))[:, None]
    colour = torch.where(sign[:, None], mix(board, rgb("26282b"), 0.85 * letters), colour)
    colour = torch.where((v < 0.5)[:, None], stones(plane, foot), colour)
    return Paint(albedo=torch.where(pane[:, None], inside, colour), gloss=0.9 * pane.float())


def build(seed: int, settings: Settings) -> Builder:
    """Everything that stands still."""
    rng = np.random.Generator(np.random.PCG64((seed, 51)))
    world = Builder()
    end = settings.speed * settings.frames / RATE + 95.0
    flat = polygon([[-60, -90, 0], [end + 60, -90, 0], [end + 60, 90, 0], [-60, 90, 0]])
    world.add("ground", [(flat, ground)])
    tones = ("d8c9a8", "c7a682", "b9705a", "cbc6bb", "a8583f", "dcd5c5", "9fa6a0")
    for side in (-1.0, 1.0):
        x = -45.0
        while x < end:
            long = float(rng.uniform(8.0, 15.0))
            if abs(x + long / 2 - CROSSING) > long / 2 + 7.0:
                _house(world, x + long / 2, side, long, tones, rng)
            x += long
        for x in np.arange(-30.0, end, 11.0):
            if abs(x - CROSSING) > 9:
                tree(world, x + rng.uniform(-1, 1), side * (CARRIAGE + 0.9), rng, detail=3)
                _lamp(world, x + 5.5, side)
        for x in np.arange(-25.0, end, 6.2):
            if rng.random() < 0.55 and abs(x - CROSSING) > 10:
                parked_car(world, x, side * (CARRIAGE - 1.15), 0.0, rng)
    return world


def _house(world: Builder, x: Number, side: Number, long: Number, tones: tuple[str, ...],
           rng: np.random.Generator) -> None:  # fmt: skip
    """A house in the row: shop below, storeys above, a gabled or a flat roof."""
    deep, floors = 11.0, int(rng.integers(2, 5))
    wall = Facade(tones=tones, storey=3.0, bay=float(rng.choice([2.3, 2.7, 3.2])), door=False,
                  brick=bool(rng.random() < 0.35), shutters=bool(rng.random() < 0.4))  # fmt: skip
    y = side * (CARRIAGE + WALK + deep / 2 + 0.05)
    shop = [(things.walls([[-long / 2, -deep / 2], [long / 2, -deep / 2], [long / 2, deep / 2],
                           [-long / 2, deep / 2]], 0.0, 3.6), shopfront)]  # fmt: skip
    if rng.random() < 0.6:
        upper = things.house(long, deep, 3.0 * floors, float(rng.uniform(3, 4.5)), wall)
    else:
        upper = things.flat_house((long, deep, 3.0 * floors + 0.6), wall, rng)
    world.add("building", things.moved(shop + things.moved(upper, (0.0, 0.0, 3.6)), (x, y, 0.0)))


def _lamp(world: Builder, x: Number, side: Number) -> None:
    """A street lamp that leans over the road."""
    pole = cylinder(0.09, 6.5, 8, 0.06)
    arm = placed(box((0.08, 1.8, 0.08)), (0.0, -0.85 * side, 6.4))
    head = placed(box((0.25, 0.6, 0.12)), (0.0, -1.6 * side, 6.32))
    grey = Solid(tone="5d6266", dirt=0.3)
    world.add("lamp", [(placed(joined(pole, arm, head), (x, side * (CARRIAGE + 0.5), 0.0)), grey)])


def movers(seed: int) -> list[traffic.Mover]:
    """Cars of different speeds, one that turns, and people."""
    rng = np.random.Generator(np.random.PCG64((seed, 52)))
    cars = [
        traffic.car("b0282c", 4.4, traffic.straight(17.0, -1.7, 6.5)),
        traffic.car("d9dadc", 4.2, traffic.straight(46.0, 1.7, -11.0)),
        traffic.car("2d4a7a", 4.6, traffic.straight(78.0, 1.9, -8.0)),
        traffic.car("c9a227", 4.1, traffic.turning(CROSSING + 2.0, -22.0, 6.0, 6.5)),
    ]
    people = [
        traffic.walker(seed * 7 + index, float(rng.uniform(4, 40)), side * (CARRIAGE + 2.2 + 0.3 * index % 1),
                       float(rng.choice([-1.4, 1.1, 1.5])))
        for index, side in enumerate((-1.0, 1.0, -1.0, 1.0, -1.0, 1.0))
    ]  # fmt: skip
    crossing = traffic.walker(seed * 7 + 9, CROSSING - 7.6, -5.0, 1.5, across=True)
    return [*cars, *people, crossing]


class Drive:
    """The street at any moment; the last few moments are kept."""

    def __init__(self, seed: int, settings: Settings):
        """Build what stands still."""
        self.settings, self.seed = settings, seed
        self.still = build(seed, settings)
        self.movers = movers(seed)
        self.first = len(self.still.kinds)
        """Object id of the first mover."""
        self.kinds = (*self.still.kinds, *(mover.kind for mover in self.movers))
        self._lock, self._stages, self._light = Lock(), OrderedDict(), None

    def stage(self, time: Number) -> Stage:
        """The lit street at a time in seconds."""
        with self._lock:
            if self._light is None:
                reach = self.settings.speed * self.settings.frames / RATE + 70.0
                self._light = Daylight(
                    Caster(self.still.build()), Sky(azimuth=1.2, elevation=0.75),
                    (-30.0, -24.0, -0.5), (reach, 24.0, 18.0), self.settings.cell,
                )  # fmt: skip
            if time not in self._stages:
                world = self.still.copy()
                for mover in self.movers:
                    world.add(mover.kind, mover.at(time))
                caster = Caster(world.build())
                seeds = object_seeds(len(self.kinds), self.seed)
                self._stages[time] = Stage(
                    caster=caster, lighting=self._light.seen_by(caster), object_seeds=seeds
                )
                while len(self._stages) > 3:
                    self._stages.popitem(last=False)
            return self._stages[time]

    def eye(self, time: Number) -> np.ndarray:
        """Place of the front camera."""
        return np.array([self.settings.speed * time, -1.7, 1.7])


def shots(drive: Drive) -> tuple[Shot, ...]:
    """Three cameras a frame, and some frames again from other lanes."""
    settings = drive.settings
    size, focal = (settings.width, settings.height), 0.72 * settings.width
    found = []
    # the first frame is among them: both scenes then count time from the same moment
    again = set(np.linspace(0, settings.frames - 2, settings.shifted).astype(int).tolist())
    for index in range(settings.frames):
        time = index / RATE
        for name, yaw in CAMERAS.items():
            angle = np.radians(yaw)
            way = np.array([np.cos(angle), np.sin(angle), -0.03])
            file = f"frame_{index:04d}_{name}.png"
            eye = drive.eye(time)
            camera = looking(eye, eye + way, size, focal)
            found.append(Shot(name=file, camera=camera, time=time, sensor=name))
            if index in again:
                for shift in SHIFTS:
                    moved = eye + np.array([0.0, shift, 0.0])
                    camera = looking(moved, moved + way, size, focal)
                    other = f"frame_{index:04d}_{name}_{shift:+.1f}m.png"
                    found.append(
                        Shot(name=other, camera=camera, time=time, sensor=name, group=SHIFTED)
                    )
    return tuple(found)


def _extras(drive: Drive, folder: Path) -> None:
    """Write lidar/frame_<n>.npz and motion.npz."""
    settings = drive.settings
    for index in range(settings.frames):
        path = folder / "lidar" / f"frame_{index:04d}.npz"
        if path.exists():
            continue
        time = index / RATE
        eye = drive.eye(time) + np.array([-0.4, 0.0, 0.35])
        found = lidar.sweep(
            drive.stage(time).caster, eye, 0.0, settings.columns, drive.seed * 1_000_003 + index
        )
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer, points=found.points.astype(np.float32), ranges=found.ranges.astype(np.float32),
            beams=found.beams.astype(np.uint8), azimuths=found.azimuths.astype(np.float32),
            objects=found.objects.astype(np.int32), origin=eye, time=time,
        )  # fmt: skip
        write_bytes(path, buffer.getvalue())
    times = np.arange(settings.frames) / RATE
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, times=times, objects=drive.first + np.arange(len(drive.movers)),
        poses=np.array([[mover.pose(float(t)) for mover in drive.movers] for t in times]),
        rigid=np.array([mover.kind != "walker" for mover in drive.movers]),
    )  # fmt: skip
    write_bytes(folder / "motion.npz", buffer.getvalue())


def plan(seed: int, settings: Settings) -> Plan:
    """The whole scene of a seed."""
    drive = Drive(seed, settings)
    tests = [
        f"frame_{i:04d}_{name}.png" for i in range(0, settings.frames, HELD) for name in CAMERAS
    ]
    return Plan(
        world="street", settings=asdict(settings), seed=seed, shots=shots(drive),
        stage=lambda shot: drive.stage(shot.time), samples=settings.samples, features=400,
        movable={"moving car": "vehicles", "walker": "people"},
        kinds={"": drive.kinds}, driven=True,
        extras=lambda folder: _extras(drive, folder),
        facts={
            "test": ",".join(tests),
            "lidar": "lidar/frame_*.npz: points (world, noisy), ranges (true), beams, objects, origin",
            "moving": "moving/vehicles, moving/people: masks of what moves, a file a view",
            "motion": "motion.npz: poses[frame, mover] world from object, objects (ids), rigid",
            "lane_shift": "views in the folder lane_shift: the same moments from other lanes",
        },
    )  # fmt: skip
