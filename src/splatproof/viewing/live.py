"""A model that is shown while it trains, by a process that takes only what time others leave."""

import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import torch

from splatproof.base.local_server import HOST, listening, server_of
from splatproof.base.processes import Worker
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.training.snapshots import SNAPSHOT, read_snapshot
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene
from splatproof.viewing.server import application
from splatproof.viewing.stage import Shown, Stage

NICE = 15
"""Where training wants all cores, pictures get 36 parts of a core's time to 1024 of training, 3.4 %; the
rest of what they need is time that nobody else wants. At 19 it is 1.4 %, and pages take minutes to come."""
LOOKS = 0.5
"""Seconds between two looks for a newer snapshot."""


@contextmanager
def watched(
    scene: str, protocol: Protocol, name: str, say: Callable[[str], None]
) -> Iterator[Path]:
    """A viewer in a process of its own while the block runs, and the folder that it shows snapshots of.

    Args:
        scene: Scene that is trained on, for cameras and photos.
        protocol: Rules by which it is opened.
        name: What the model is called on the page.
        say: Told the page's address.
    Raises: MissingError or DataError by the training itself, if the scene does not open.
    """
    with tempfile.TemporaryDirectory(prefix="splatproof-view-") as folder, listening(0) as at:
        port = at.getsockname()[1]
        with Worker(serve_snapshots, at, Path(folder), scene, protocol, name):
            say(f"the model while it trains: http://{HOST}:{port}/")
            yield Path(folder)


def serve_snapshots(
    connection: Connection,
    at: socket.socket,
    folder: Path,
    scene: str,
    protocol: Protocol,
    name: str,
) -> None:
    """What the viewer's process does: wait for the first snapshot, then serve the newest until killed.

    Args:
        connection: To the process that trains; nothing is said.
        at: Where the page is served.
        folder: Where snapshots lie.
        scene: Scene that is trained on.
        protocol: Rules by which it is opened.
        name: What the model is called.
    """
    del connection
    torch.set_num_threads(1)
    opened = open_scene(scene, protocol)
    os.nice(NICE)  # not before: imports alone would take minutes
    while not (folder / SNAPSHOT).exists():
        time.sleep(LOOKS)
    stage = Stage((newest(folder, opened, name),), opened, torch.tensor(protocol.background))
    threading.Thread(target=_follow, args=(folder, stage, opened), daemon=True).start()
    server_of(application(stage, at.getsockname()[1])).run(sockets=[at])


def newest(folder: Path, scene: Scene, name: str) -> Shown:
    """The newest snapshot as a model that can be drawn.

    Args:
        folder: Where it lies.
        scene: What it is trained on.
        name: What it is called.
    """
    step, steps, model = read_snapshot(folder)
    drawn = DecodedModel.of("in training", model, scene, "cpu")
    return Shown(name=name, model=drawn, step=step, steps=steps)


def _follow(folder: Path, stage: Stage, scene: Scene) -> None:
    """Put each new snapshot on the stage."""
    seen = (folder / SNAPSHOT).stat().st_mtime_ns
    while True:
        time.sleep(LOOKS)
        now = (folder / SNAPSHOT).stat().st_mtime_ns
        if now != seen:
            stage.models, seen = (newest(folder, scene, stage.models[0].name),), now
