"""Scores and pictures of one held-out view, made here or, where photos are large, by processes beside this one."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import final

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8, UInt16
from torch import Tensor

from splatproof.base.errors import SplatproofError
from splatproof.base.memory import MEBIBYTE, SHARE, available_mb
from splatproof.base.processes import Worker, listening
from splatproof.datasets.photos import write_png
from splatproof.metrics.ldr_flip import flip_map
from splatproof.metrics.pairs import check_pair
from splatproof.metrics.registry import find_metric
from splatproof.metrics.scoring import prepare, region_columns, score_image
from splatproof.metrics.seen_part import with_seen
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore

LARGE = 8_000_000
"""Pixels of all views together from which on other processes help. FLIP, the longest, takes 1.6 us a pixel on one
core and knows no threads; to start the processes takes about three seconds."""
BYTES = 640
"""Bytes a pixel that one view takes at its peak: 374 were measured in the process that scores 2.4 megapixels by the
default protocol, its copies on the way there take 60, and half as much again is for other metrics."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One view as it is scored: arrays alone, so that it can be sent to another process."""

    name: str
    """Name of the view."""
    picture: str
    """Name of its pictures."""
    render: Float32[np.ndarray, "h w 3"]
    """What the model shows, as it is scored."""
    truth: Float32[np.ndarray, "_h _w 3"]
    """What the camera saw."""
    shown: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]
    """The render as it is written."""
    true: UInt8[np.ndarray, "_h _w 3"] | UInt16[np.ndarray, "_h _w 3"]
    """The truth as it is written."""
    mask: Bool[np.ndarray, "_h _w"] | None
    """True where a pixel counts; None: everywhere."""
    moving: Mapping[str, Bool[np.ndarray, "_h _w"]] | None
    """What moves, by kind; None: no part is scored."""
    seen: Bool[np.ndarray, "_h _w"] | None
    """True where a training photo can have shown the pixel; None: not known of this image."""
    known: bool
    """Whether that is known of any image of the scene, so that every one has a share."""
    apart: bool
    """Whether what is seen is scored apart."""


@dataclass(frozen=True, kw_only=True)
class Folders:
    """Where the pictures go; all are there."""

    renders: Path
    truth: Path
    errors: Path
    masks: Path | None
    """None: no view of the scene has a mask."""


def score_shot(shot: Shot, protocol: Protocol, folders: Folders) -> ImageScore:
    """Score one view and write its pictures.

    Args:
        shot: The view.
        protocol: The rules.
        folders: Where the pictures go.
    Raises: DataError where the view cannot be scored.
    """
    render, truth = torch.from_numpy(shot.render), torch.from_numpy(shot.truth)
    mask, seen = _tensor(shot.mask), _tensor(shot.seen)
    moving = None
    if shot.moving is not None:
        moving = {kind: torch.from_numpy(own) for kind, own in shot.moving.items()}
    score = score_image(shot.name, render, truth, protocol, mask, moving)
    if shot.known:
        score = with_seen(score, render, truth, protocol, mask, seen, apart=shot.apart)
    write_png(folders.renders / shot.picture, shot.shown)
    write_png(folders.truth / shot.picture, shot.true)
    error = error_picture(shot.name, render, truth, protocol, mask)
    write_png(folders.errors / shot.picture, error)
    if folders.masks:
        valid = np.ones(shot.truth.shape[:2], bool) if shot.mask is None else shot.mask
        write_png(
            folders.masks / shot.picture, np.repeat(valid[..., None] * np.uint8(255), 3, axis=2)
        )
    return score


def error_picture(
    name: str, render: Tensor, truth: Tensor, protocol: Protocol, mask: Tensor | None
) -> UInt8[np.ndarray, "h w 3"]:
    """FLIP of what is scored as colours: black (equal) over red to yellow-white (1).

    Args:
        name: Name of the view, for errors.
        render: The model's image, h x w x 3, sRGB in [0, 1].
        truth: The photo, of the same size.
        protocol: The rules: what of the image is scored.
        mask: True where a pixel is valid, h x w; None: everywhere.
    Returns: A picture of the whole image, black where nothing is scored.
    """
    ready = prepare(render, truth, protocol, mask, name=name)
    pair = check_pair(ready.render, ready.truth, ready.mask, metric="error map")
    error = np.where(pair.valid, flip_map(pair), 0.0)
    whole = np.zeros(render.shape[:2])
    whole[:, region_columns(render.shape[1], protocol.region)] = error
    colours = cv2.applyColorMap((whole * 255).round().astype(np.uint8), cv2.COLORMAP_MAGMA)
    return np.asarray(colours[..., ::-1], dtype=np.uint8)


def helpers(views: int, pixels: int, protocol: Protocol) -> int:
    """How many processes score views beside this one; 0: they are scored here.

    As many as threads may be used, as there are views, and as memory has room for. None where a
    metric is a network: it takes memory of its own, and all threads.

    Args:
        views: Number of views.
        pixels: Pixels of the largest of them.
        protocol: The rules, with the metrics.
    """
    if views * pixels < LARGE or any(find_metric(n).load_weights for n in protocol.metrics):
        return 0
    room = int(SHARE * available_mb() * MEBIBYTE / (BYTES * pixels))
    count = min(torch.get_num_threads(), views, room)
    return count if count > 1 else 0


@final
class Scorers:
    """Who scores views: processes of their own, or this one. To be used in a `with` block."""

    def __init__(self, count: int, protocol: Protocol, folders: Folders) -> None:
        """Start them.

        Args:
            count: Number of processes beside this one; 0: views are scored here.
            protocol: The rules.
            folders: Where the pictures go.
        """
        self._rules, self._folders = protocol, folders
        self._scores: list[ImageScore] = []
        self._at_work: dict[Worker, Shot] = {}
        self._workers = [
            Worker(_serve, protocol, folders, preload=[__name__]) for _ in range(count)
        ]
        self.cpu_seconds = 0.0
        """CPU seconds that the other processes spent."""

    @property
    def done(self) -> int:
        """Number of views that are scored."""
        return len(self._scores)

    def give(self, shot: Shot) -> None:
        """Have a view scored; waits while all are at work.

        Raises: DataError where this view, or one that was given before, cannot be scored.
        """
        if self._workers and not self._idle():
            self._hear()
        if not self._idle():  # none was started, or none is left
            self._scores.append(score_shot(shot, self._rules, self._folders))
            return
        worker = self._idle()[0]
        self._at_work[worker] = shot
        try:
            worker.send(shot)
        except EOFError:
            self._lost(worker)

    def scores(self) -> tuple[ImageScore, ...]:
        """Scores of all views that were given, sorted by name; waits for them.

        Raises: DataError where one cannot be scored.
        """
        while self._at_work:
            self._hear()
        return tuple(sorted(self._scores, key=lambda score: score.name))

    def __enter__(self) -> "Scorers":
        """The scorers themselves."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes."""
        for worker in self._workers:
            worker.close()

    def _idle(self) -> list[Worker]:
        return [worker for worker in self._workers if worker not in self._at_work]

    def _hear(self) -> None:
        """Wait until some have scored a view, and keep what they say."""
        for worker in listening(list(self._at_work)):
            try:
                score, seconds = worker.receive()
            except EOFError:
                self._lost(worker)
                continue
            if isinstance(score, SplatproofError):
                raise score
            self._scores.append(score)
            self.cpu_seconds += seconds
            del self._at_work[worker]

    def _lost(self, worker: Worker) -> None:
        """Do here what a process had to do that ended, for want of memory perhaps."""
        shot = self._at_work.pop(worker)
        self._workers.remove(worker)
        worker.close()
        self._scores.append(score_shot(shot, self._rules, self._folders))


def _serve(says: Connection, protocol: Protocol, folders: Folders) -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    while True:
        try:
            shot = says.recv()
        except EOFError:
            return
        began = time.process_time()
        try:
            score = score_shot(shot, protocol, folders)
        except SplatproofError as error:
            score = error
        says.send((score, time.process_time() - began))


def _tensor(values: Bool[np.ndarray, "h w"] | None) -> Bool[Tensor, "h w"] | None:
    return None if values is None else torch.from_numpy(values)
