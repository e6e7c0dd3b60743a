"""How fast a viewer is: frames asked for over its own server, as the page asks for them."""

import math
import statistics
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from http.client import HTTPConnection
from json import loads
from typing import Any
from urllib.parse import urlencode

import cv2
import numpy as np
import torch

from splatproof.base.errors import SplatproofError
from splatproof.base.local_server import HOST, listening, server_of
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.metrics.pixel import psnr
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.twins.random_scenes import speed_scene
from splatproof.viewing.asked import read_asked
from splatproof.viewing.frames import picture_of
from splatproof.viewing.paths import orbit
from splatproof.viewing.poses import typical_field
from splatproof.viewing.server import application
from splatproof.viewing.stage import Shown, Stage

GAUSSIANS = 100_000
WIDTH, HEIGHT, QUALITY = 640, 360, 80
"""What is asked for: pixels, and the JPEG quality of a page that moves."""
WARM_UP = 3
"""Frames that are not counted: caches fill, threads start."""


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Medians over all frames."""

    frames: int
    primitives: int
    threads: int
    render_ms: float
    """Wall time of drawing one frame."""
    encode_ms: float
    """Wall time of its JPEG."""
    round_trip_ms: float
    """Wall time from the request to the last byte of the answer."""
    cpu_ms: float
    """Processor time of this process a frame, all threads, asking included; the mean."""
    frames_per_second: float
    """Frames by the wall time of the whole walk: one after the other."""
    jpeg_psnr: float
    """dB of the frames that arrive against the exact render, the smallest of four."""

    def record(self) -> dict[str, Any]:
        """What --json prints."""
        return asdict(self) | {"width": WIDTH, "height": HEIGHT, "quality": QUALITY}

    def text(self) -> str:
        """What a person reads."""
        return (
            f"{self.frames_per_second:.1f} frames/s of {WIDTH} x {HEIGHT}, {self.primitives} "
            f"primitives, {self.threads} threads: round trip {self.round_trip_ms:.1f} ms (render "
            f"{self.render_ms:.1f}, JPEG {self.encode_ms:.1f}), {self.cpu_ms:.1f} ms of processor "
            f"time a frame; JPEG {self.jpeg_psnr:.1f} dB from the render"
        )


def random_stage(backend: str) -> tuple[Stage, Camera]:
    """100,000 random Gaussians that all lie in the image of one camera, and that camera.

    They are those that `bench study speed` times rasterizers on: 1 to 4 pixels wide, all over the
    image, harmonics of degree 3.

    Args:
        backend: Name of the rasterizer.
    """
    made, _ = speed_scene(GAUSSIANS, WIDTH, HEIGHT)
    model = Gaussians(
        means=made.means, quaternions=made.quaternions, log_scales=made.scales.log(),
        opacity_logits=made.opacities.logit(), sh=made.sh,
    )  # fmt: skip
    shown = Shown(name="random Gaussians", model=ExplicitModel(model=model, backend=backend))
    return Stage((shown,), None), made.camera


def measured(stage: Stage, cameras: Sequence[Camera]) -> Speed:
    """Serve a stage on this machine, ask for frames one after the other, and stop.

    Args:
        stage: Its first model is measured.
        cameras: Where frames are seen from; the first WARM_UP are not counted.
    Raises: SplatproofError if an answer is no frame.
    """
    at = listening(0)
    server = server_of(application(stage, at.getsockname()[1]))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [at]}, daemon=True)
    thread.start()
    line = HTTPConnection(HOST, at.getsockname()[1], timeout=60)
    try:
        return _walk(line, stage, [query(camera, i) for i, camera in enumerate(cameras)])
    finally:
        line.close()
        server.should_exit = True
        thread.join(10)


def _walk(line: HTTPConnection, stage: Stage, told: list[dict[str, str]]) -> Speed:
    frames = len(told) - WARM_UP
    for one in told[:WARM_UP]:
        _ask(line, one)
    started, before = time.perf_counter(), time.process_time()
    answers = [_ask(line, one) for one in told[WARM_UP:]]
    wall, spent = time.perf_counter() - started, time.process_time() - before
    some = [int(i * frames / 4) for i in range(min(4, frames))]
    off = [_psnr(stage, told[WARM_UP + i], answers[i][2]) for i in some]
    facts = [loads(answer[1]) for answer in answers]
    return Speed(
        frames=frames, primitives=stage.models[0].model.primitives,
        threads=torch.get_num_threads(),
        render_ms=statistics.median(fact["render_ms"] for fact in facts),
        encode_ms=statistics.median(fact["encode_ms"] for fact in facts),
        round_trip_ms=statistics.median(answer[0] for answer in answers),
        cpu_ms=1000 * spent / frames, frames_per_second=frames / wall, jpeg_psnr=min(off),
    )  # fmt: skip


def walk(stage: Stage, frames: int) -> list[Camera]:
    """Cameras once round the scene, and those of the warm-up before.

    Args:
        stage: What is shown.
        frames: How many count.
    """
    field = min(90.0, typical_field(stage.training))
    round_it = orbit(stage, frames, width=WIDTH, height=HEIGHT, field=field)
    return [*(round_it[:1] * WARM_UP), *round_it]


def sway(camera: Camera, frames: int) -> list[Camera]:
    """A camera that sways sideways by half a hundredth of a unit, the warm-up included.

    Args:
        camera: The camera in the middle.
        frames: How many count.
    """
    cameras = []
    for step in range(WARM_UP + frames):
        pose = camera.world_to_camera.clone()
        pose[0, 3] += 0.005 * math.sin(step)
        cameras.append(replace(camera, world_to_camera=pose))
    return cameras


def query(camera: Camera, turn: int) -> dict[str, str]:
    """What the page would ask for to see a camera's picture.

    Args:
        camera: Its principal point is in the middle.
        turn: Number of the wish.
    """
    directions = {"eye": camera.centre, "forward": camera.rotation[2], "up": -camera.rotation[1]}
    told = {name: ",".join(map(repr, value.tolist())) for name, value in directions.items()}
    field = 2 * math.degrees(math.atan(HEIGHT / 2 / float(camera.K[1, 1])))
    return told | {
        "fov": repr(field), "width": str(WIDTH), "height": str(HEIGHT), "quality": str(QUALITY),
        "page": "measure", "turn": str(turn),
    }  # fmt: skip


def _ask(line: HTTPConnection, told: dict[str, str]) -> tuple[float, str, bytes]:
    """Milliseconds, facts and bytes of one frame."""
    started = time.perf_counter()
    line.request("GET", f"/frame?{urlencode(told)}")
    answer = line.getresponse()
    data = answer.read()
    if answer.status != 200:
        raise SplatproofError(f"the viewer answered {answer.status}: {data[:200]!r}")
    return 1000 * (time.perf_counter() - started), answer.headers["X-Frame"], data


def _psnr(stage: Stage, told: dict[str, str], jpeg: bytes) -> float:
    exact = picture_of(stage, read_asked(stage, told))[0]
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    arrived = torch.from_numpy(np.ascontiguousarray(image[..., ::-1])).float() / 255
    return psnr(arrived, exact)
