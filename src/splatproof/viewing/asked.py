"""What the page asks for, read from an address and checked."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from splatproof.base.errors import UsageError
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import View
from splatproof.viewing.modes import mode_named
from splatproof.viewing.poses import NEAREST, looking, resized
from splatproof.viewing.stage import Stage

WIDEST = 2560
"""Most pixels along a side of a picture."""
FIELDS = frozenset(
    [
        "eye",
        "forward",
        "up",
        "fov",
        "width",
        "height",
        "mode",
        "model",
        "other",
        "split",
        "time",
        "light",
        "photo",
        "quality",
        "page",
        "turn",
    ]
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """One picture that the page wants."""

    camera: Camera
    mode: str
    model: int
    """Number of the model."""
    other: int | None
    """Number of the model that is shown right of the split; None: there is no split."""
    split: float
    """Share of the width that the first model has."""
    time: float | None
    light: str | None
    """Name of the training view whose light is shown."""
    photo: View | None
    """View of the scene whose camera it is; None: a free camera."""
    quality: int
    """JPEG quality, 1 to 100."""


def read_asked(stage: Stage, told: Mapping[str, str]) -> Asked:
    """The picture that an address asks for.

    Args:
        stage: What is shown.
        told: Its query: width and height in pixels; eye, forward and up (three numbers each, scene
            frame) and fov (vertical, degrees), or photo (number of a view of the scene, whose camera
            counts, with the height in proportion); mode, model, other, split, time, light, quality.
    Raises: UsageError, naming the field, what it is and what was expected.
    """
    strange = sorted(told.keys() - FIELDS)
    if strange:
        raise UsageError(f"unknown field {strange[0]!r}")
    views = () if stage.scene is None else stage.scene.views
    width = whole(told, "width", 1, WIDEST)
    number = whole(told, "photo", 0, len(views) - 1) if told.get("photo") else None
    photo = None if number is None else views[number]
    light = told.get("light") or None
    if light is not None and light not in {view.name for view in stage.training}:
        raise UsageError(f"light {light!r}: not the name of a training view")
    return Asked(
        camera=_free(stage, told, width) if photo is None else resized(photo.camera, width),
        mode=_mode(told), model=whole(told, "model", 0, len(stage.models) - 1, 0),
        other=whole(told, "other", 0, len(stage.models) - 1) if told.get("other") else None,
        split=number_in(told, "split", 0.0, 1.0, 0.5),
        time=number_in(told, "time", -1e9, 1e9) if told.get("time") else None,
        light=light, photo=photo, quality=whole(told, "quality", 1, 100, 90),
    )  # fmt: skip


def _free(stage: Stage, told: Mapping[str, str], width: int) -> Camera:
    eye, forward, up = (_three(told, name) for name in ("eye", "forward", "up"))
    return looking(
        eye, forward, up, field=number_in(told, "fov", 1.0, 170.0, 50.0), width=width,
        height=whole(told, "height", 1, WIDEST), near=NEAREST * stage.place.radius,
    )  # fmt: skip


def _mode(told: Mapping[str, str]) -> str:
    name = told.get("mode", "colour")
    mode_named(name)
    return name


def _three(told: Mapping[str, str], name: str) -> torch.Tensor:
    parts = told.get(name, "").split(",")
    if len(parts) != 3:
        raise UsageError(f"{name} is {told.get(name, '')!r}, expected three numbers with commas")
    return torch.tensor([_number(name, part) for part in parts], dtype=torch.float64)


def number_in(
    told: Mapping[str, str], name: str, low: float, high: float, usual: float | None = None
) -> float:
    """A number of the query.

    Args:
        told: The query.
        name: Field.
        low: Smallest that is allowed.
        high: Largest.
        usual: Where the field is absent; None: it must be there.
    Raises: UsageError.
    """
    if name not in told and usual is not None:
        return usual
    value = _number(name, told.get(name, ""))
    if not low <= value <= high:
        raise UsageError(f"{name} is {told[name]}, expected {low:g} to {high:g}")
    return value


def whole(told: Mapping[str, str], name: str, low: int, high: int, usual: int | None = None) -> int:
    """A whole number of the query.

    Args:
        told: The query.
        name: Field.
        low: Smallest that is allowed.
        high: Largest.
        usual: Where the field is absent; None: it must be there.
    Raises: UsageError.
    """
    value = number_in(told, name, float(low), float(high), None if usual is None else float(usual))
    if value != int(value):
        raise UsageError(f"{name} is {told[name]}, expected a whole number")
    return int(value)


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{name} is {text!r}, expected a number")
    return value
