"""How fast a viewer is: frames asked for over its own server, as the page asks for them."""

import math
import socket
import statistics
import threading
import time
from dataclasses import asdict, dataclass
from http.client import HTTPConnection
from json import loads
from typing import Any
from urllib.parse import urlencode

import cv2
import numpy as np
import torch

from splatproof.base.errors import SplatproofError
from splatproof.base.local_server import HOST
from splatproof.metrics.pixel import psnr
from splatproof.viewing.asked import read_asked
from splatproof.viewing.frames import picture_of
from splatproof.viewing.paths import orbit
from splatproof.viewing.poses import typical_field
from splatproof.viewing.stage import Stage

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


def measured(server: Any, at: socket.socket, stage: Stage, frames: int) -> Speed:
    """Serve, ask for frames on a walk once round the scene, and stop.

    Args:
        server: A uvicorn server that has not started.
        at: Its socket.
        stage: What it shows; its first model is measured.
        frames: How many.
    Raises: SplatproofError if an answer is no frame.
    """
    thread = threading.Thread(target=server.run, kwargs={"sockets": [at]}, daemon=True)
    thread.start()
    line = HTTPConnection(HOST, at.getsockname()[1], timeout=60)
    try:
        return _walk(line, stage, frames)
    finally:
        line.close()
        server.should_exit = True
        thread.join(10)


def _walk(line: HTTPConnection, stage: Stage, frames: int) -> Speed:
    told = queries(stage, WARM_UP + frames)
    for query in told[:WARM_UP]:
        _ask(line, query)
    started, before = time.perf_counter(), time.process_time()
    answers = [_ask(line, query) for query in told[WARM_UP:]]
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


def queries(stage: Stage, count: int) -> list[dict[str, str]]:
    """What the page would ask for on a walk once round the scene.

    Args:
        stage: What is shown.
        count: Frames.
    """
    cameras = orbit(
        stage, count, width=WIDTH, height=HEIGHT, field=min(90.0, typical_field(stage.training))
    )
    told = []
    for number, camera in enumerate(cameras):
        directions = {
            "eye": camera.centre,
            "forward": camera.rotation[2],
            "up": -camera.rotation[1],
        }
        told.append(
            {name: ",".join(map(repr, value.tolist())) for name, value in directions.items()}
            | {"fov": repr(2 * math.degrees(math.atan(HEIGHT / 2 / float(camera.K[1, 1])))),
               "width": str(WIDTH), "height": str(HEIGHT), "quality": str(QUALITY),
               "page": "measure", "turn": str(number)}
        )  # fmt: skip
    return told


def _ask(line: HTTPConnection, query: dict[str, str]) -> tuple[float, str, bytes]:
    """Milliseconds, facts and bytes of one frame."""
    started = time.perf_counter()
    line.request("GET", f"/frame?{urlencode(query)}")
    answer = line.getresponse()
    data = answer.read()
    if answer.status != 200:
        raise SplatproofError(f"the viewer answered {answer.status}: {data[:200]!r}")
    return 1000 * (time.perf_counter() - started), answer.headers["X-Frame"], data


def _psnr(stage: Stage, query: dict[str, str], jpeg: bytes) -> float:
    exact = picture_of(stage, read_asked(stage, query))[0]
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    arrived = torch.from_numpy(np.ascontiguousarray(image[..., ::-1])).float() / 255
    return psnr(arrived, exact)
