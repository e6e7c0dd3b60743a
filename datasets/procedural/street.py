"""A drive down a street: three front cameras, moving cars and people, a LiDAR, and other lanes' views."""

import io
from collections import OrderedDict
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock

import numpy as np

from splatproof.base.files import write_bytes
from splatproof.datasets.procedural import lidar, street_still, traffic
from splatproof.datasets.procedural.daylight import Daylight, Sky
from splatproof.datasets.procedural.flights import looking
from splatproof.datasets.procedural.plan import Plan, Shot, Stage, object_seeds
from splatproof.datasets.procedural.street_still import CARRIAGE, CROSSING
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number

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


def movers(seed: int) -> list[traffic.Mover]:
    """Cars of different speeds, one that turns, and people."""
    rng = np.random.Generator(np.random.PCG64((seed, 52)))
    cars = [
        traffic.car("b0282c", 4.4, traffic.straight(17.0, -1.7, 9.2)),
        traffic.car("d9dadc", 4.2, traffic.straight(46.0, 1.7, -11.0)),
        traffic.car("2d4a7a", 4.6, traffic.straight(75.0, 1.9, -5.5)),
        traffic.car("c9a227", 4.1, traffic.turning(CROSSING + 2.0, -22.0, 6.0, 6.5, lane=1.7)),
    ]
    people = [  # a lane of the pavement each; on the right, away from the car that turns
        traffic.walker(seed * 7 + index, float(rng.uniform(4, 40 if index % 2 else 28)),
                       (1 if index % 2 else -1) * (CARRIAGE + 1.55 + 0.7 * (index // 2)),
                       float(rng.choice([-1.4, 1.1, 1.5])))
        for index in range(6)
    ]  # fmt: skip
    crossing = traffic.walker(seed * 7 + 9, CROSSING - 7.6, 7.2, -1.5, across=True, until=9.6)
    return [*cars, *people, crossing]


class Drive:
    """The street at any moment; the last few moments are kept."""

    def __init__(self, seed: int, settings: Settings):
        """Build what stands still.

        Args:
            seed: Another seed makes another street.
            settings: How long is driven and what is recorded.
        """
        self.settings, self.seed = settings, seed
        self.still = street_still.build(seed, settings.speed * settings.frames / RATE + 95.0)
        self.movers = movers(seed)
        self.first = len(self.still.kinds)
        """Object id of the first mover."""
        self.kinds = (*self.still.kinds, *(mover.kind for mover in self.movers))
        self._lock = Lock()
        self._stages: OrderedDict[Number, Stage] = OrderedDict()
        self._light: Daylight | None = None

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
    """The whole scene of a seed.

    Args:
        seed: Another seed makes another street; 0 or more.
        settings: How long is driven and what is recorded.
    """
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
