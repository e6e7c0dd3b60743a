"""What a COLMAP model has no place for, beside it: views.json (time, camera) and sky/<stem>.png."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_json, write_bytes
from splatproof.base.numbers import finite

NAME = "views.json"
SKY = "sky"
EXPECTED = '{"<photo>": {"time": <seconds>, "sensor": "<camera, may be left out>"}, ...}'
"""What views.json looks like, for errors."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """When a view was taken, and by which camera."""

    time: float
    """Seconds from any start."""
    sensor: str = ""
    """Name of the camera; empty: the model's camera says which."""


def sky_path(scene: Path, name: str) -> Path:
    """Path of the file that has a view's sky mask, whether it exists or not.

    Args:
        scene: The scene's folder.
        name: Name of the photo inside the photo folder.
    """
    return (scene / SKY / name).with_suffix(".png")


def write_moments(scene: Path, moments: Mapping[str, Moment]) -> None:
    """Write views.json.

    Args:
        scene: The scene's folder.
        moments: Name of the photo: when it was taken, and by which camera.
    """
    table = {name: asdict(moments[name]) for name in sorted(moments)}
    write_bytes(scene / NAME, (json.dumps(table, indent=1) + "\n").encode())


def read_moments(scene: Path, names: list[str]) -> dict[str, Moment]:
    """Read views.json; a view may lack its sensor.

    Args:
        scene: The scene's folder.
        names: Names of the views, each of which the file must have.
    Returns: Name of the photo: its moment; empty where the scene has no such file.
    Raises: DataError if it is no such table, or a view is missing in it.
    """
    path = scene / NAME
    if not path.is_file():
        return {}
    table = read_json(path)
    if not isinstance(table, dict):
        raise DataError(f"{path}: no table by the names of photos; write {EXPECTED}")
    found = {name: _moment(path, name, entry) for name, entry in table.items()}
    for name in names:
        if name not in found:
            raise DataError(f"{path}: view {name!r} is missing; name all views or remove the file")
    return found


def _moment(path: Path, name: str, entry: object) -> Moment:
    said = entry if isinstance(entry, dict) else {}
    seconds, sensor = finite(said.get("time")), said.get("sensor")
    if seconds is None:
        raise DataError(
            f"{path}: time of view {name!r:.60} is {said.get('time')!r:.60}, expected a finite number; "
            f"write {EXPECTED}"
        )
    return Moment(time=seconds, sensor="" if sensor is None else str(sensor))
