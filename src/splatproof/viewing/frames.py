"""Pictures of models as the page wants them: drawn, scored, encoded; of waiting wishes the newest."""

import time
from collections import OrderedDict
from dataclasses import dataclass
from threading import Lock

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.metrics.pixel import psnr
from splatproof.viewing.asked import Asked
from splatproof.viewing.modes import MODES, Looked, Picture
from splatproof.viewing.stage import Stage, asked_view

MOST_PAGES = 64
"""Pages whose newest wish is remembered."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A picture on its way to the page."""

    jpeg: bytes
    told: dict[str, str]
    """What is read beside it, by name."""
    render_ms: float
    encode_ms: float


class Wishes:
    """The newest frame that each page wants: older ones that still wait are not drawn."""

    def __init__(self) -> None:
        """Nobody wants anything yet."""
        self._newest: OrderedDict[str, int] = OrderedDict()
        self._lock = Lock()

    def add(self, page: str, turn: int) -> None:
        """Remember a wish.

        Args:
            page: Name of the page.
            turn: Number of the wish; a page counts upwards.
        """
        with self._lock:
            self._newest[page] = max(turn, self._newest.pop(page, turn))
            while len(self._newest) > MOST_PAGES:
                self._newest.popitem(last=False)

    def is_old(self, page: str, turn: int) -> bool:
        """Whether the page has asked for a newer frame since.

        Args:
            page: Name of the page.
            turn: Number of the wish.
        """
        with self._lock:
            return turn < self._newest.get(page, turn)


@torch.no_grad()
def frame_of(stage: Stage, asked: Asked) -> Frame:
    """Draw and encode what is asked.

    Args:
        stage: What is shown.
        asked: Camera, mode, models.
    Raises: UsageError for a mode that a model does not have.
    """
    started = time.perf_counter()
    picture, told = picture_of(stage, asked)
    drawn = time.perf_counter()
    jpeg = to_jpeg(picture, asked.quality)
    encoded = time.perf_counter()
    return Frame(
        jpeg=jpeg, told=told, render_ms=1000 * (drawn - started),
        encode_ms=1000 * (encoded - drawn),
    )  # fmt: skip


def picture_of(stage: Stage, asked: Asked) -> Picture:
    """The picture that is asked for; with a split each model draws all of it.

    A camera of fewer columns would not show the same: how a Gaussian far off the axis is projected
    depends on where the image ends (its Jacobian is taken no farther out than 1.3 times the field).

    Args:
        stage: What is shown.
        asked: Camera, mode, models.
    Returns: The picture in [0, 1], and what is read beside it.
    Raises: UsageError for a mode that a model does not have.
    """
    width = asked.camera.width
    cut = width if asked.other is None else round(asked.split * width)
    parts: list[Picture] = []
    if cut > 0:
        parts.append(_side(stage, asked, asked.model, slice(cut)))
    if cut < width and asked.other is not None:
        parts.append(_side(stage, asked, asked.other, slice(cut, width)))
    told = parts[0][1]
    if len(parts) == 2:
        told = {name: f"{value} | {parts[1][1].get(name, '')}" for name, value in told.items()}
    return torch.cat([picture for picture, _ in parts], dim=1), told


def _side(stage: Stage, asked: Asked, number: int, columns: slice) -> Picture:
    shown, mode = stage.models[number], MODES[asked.mode]
    missing = mode.missing(stage, shown)
    if missing:
        raise UsageError(f"{shown.name}, {mode.label.lower()}: {missing}")
    view = asked_view(
        stage, shown, asked.camera, like=asked.photo, time=asked.time, appearance=asked.light
    )
    output = shown.model.render(view, stage.background)
    picture, told = mode.draw(
        Looked(stage=stage, shown=shown, view=view, output=output, photo=asked.photo)
    )
    return picture[:, columns], told | _score(stage, asked, picture)


def _score(stage: Stage, asked: Asked, picture: Float[Tensor, "h w 3"]) -> dict[str, str]:
    """PSNR against the photo, where the whole picture is of its camera and size."""
    photo = asked.photo
    if photo is None or asked.mode != "colour" or asked.other is not None:
        return {}
    if picture.shape[:2] != photo.size:
        return {}
    return {"psnr": f"{float(psnr(picture, stage.photos.load(photo))):.2f} dB"}


def to_jpeg(picture: Float[Tensor, "h w 3"], quality: int) -> bytes:
    """A picture in [0, 1] as JPEG; from quality 90 on colour is not subsampled.

    Args:
        picture: sRGB.
        quality: 1 to 100.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    if quality >= 90:
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", bytes_of(picture)[..., ::-1], options)
    assert done
    return data.tobytes()


def bytes_of(picture: Float[Tensor, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """A picture in [0, 1] as bytes, rounded half up; what is not finite is black."""
    return (picture.nan_to_num().clamp(0, 1) * 255 + 0.5).to(torch.uint8).numpy()


def photo_jpeg(stage: Stage, number: int, width: int) -> bytes:
    """A photo of the scene, no wider than asked.

    Args:
        stage: With a scene.
        number: Number of the view.
        width: Most pixels.
    Raises: UsageError where there is no such view.
    """
    views = () if stage.scene is None else stage.scene.views
    if not 0 <= number < len(views):
        raise UsageError(f"photo {number}: the scene has {len(views)} views")
    image = bytes_of(stage.photos.load(views[number]))
    if image.shape[1] > width:
        height = max(1, round(image.shape[0] * width / image.shape[1]))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return to_jpeg(torch.from_numpy(np.asarray(image)).float() / 255, 90)
