"""What a COLMAP model has no place for, beside it: views.json (time, camera) and sky/<stem>.png."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_json, write_bytes

NAME = "views.json"
SKY = "sky"


@dataclass(frozen=True, kw_only=True)
class Moment:
    """When a view was taken, and by which camera."""

    time: float
    """Seconds from any start."""
    sensor: str
    """Name of the camera."""


def sky_path(scene: Path, name: str) -> Path:
    """File of a view's sky mask; `name` is the photo's name inside the photo folder."""
    return (scene / SKY / name).with_suffix(".png")


def write_moments(scene: Path, moments: Mapping[str, Moment]) -> None:
    """Write views.json, by photo name."""
    table = {name: asdict(moments[name]) for name in sorted(moments)}
    write_bytes(scene / NAME, (json.dumps(table, indent=1) + "\n").encode())


def read_moments(scene: Path, names: list[str]) -> dict[str, Moment]:
    """Read views.json of the views `names`; empty where the scene has none.

    Raises: DataError if it is no such table, or a view is missing in it.
    """
    path = scene / NAME
    if not path.is_file():
        return {}
    table = read_json(path)
    try:
        found = {
            name: Moment(time=float(entry["time"]), sensor=str(entry["sensor"]))
            for name, entry in table.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path}: {type(error).__name__} {error}; expected for each photo a time and a sensor"
        ) from None
    for name in names:
        if name not in found:
            raise DataError(f"{path}: view {name!r} is missing; name all views or remove the file")
    return found
