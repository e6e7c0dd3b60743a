"""scene.toml: what is known of a scene folder beyond its COLMAP model. Written by `bench ingest`."""

import json
import math
import os
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from splatproof.base.errors import DataError

NAME = "scene.toml"


@dataclass(frozen=True, kw_only=True)
class SceneFile:
    """The contents of scene.toml."""

    units: str = "sfm"
    """Name of the length unit: "metres" or "sfm"."""
    up: tuple[float, float, float] | None = None
    """Unit vector against gravity in the model's frame; None: unknown."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Photo name: why it is not in the model."""
    facts: dict[str, str] = field(default_factory=dict)
    """How the scene was made."""


def read_scene_file(folder: Path) -> SceneFile:
    """Read folder/scene.toml; a scene folder without one is described by the defaults.

    Raises: DataError if the file is not TOML or a field is not what it must be.
    """
    path = folder / NAME
    if not path.exists():
        return SceneFile()
    try:
        data = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not a TOML file ({error})") from None
    unknown = set(data) - {"units", "up", "left_out", "facts"}
    if unknown:
        raise DataError(
            f"{path}: unknown field {min(unknown)!r}; known: units, up, left_out, facts"
        )
    units = data.get("units", "sfm")
    if units not in ("metres", "sfm"):
        raise DataError(f"{path}: units is {units!r}, expected 'metres' or 'sfm'")
    tables = {}
    for name in ("left_out", "facts"):
        tables[name] = data.get(name, {})
        if not isinstance(tables[name], dict) or not all(
            isinstance(value, str) for value in tables[name].values()
        ):
            raise DataError(f"{path}: [{name}] must be a table of strings")
    return SceneFile(units=units, up=_up(path, data.get("up")), **tables)


def _up(path: Path, value: object) -> tuple[float, float, float] | None:
    if value is None:
        return None
    if (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) for x in value)
        and abs(math.hypot(*value) - 1) < 1e-6
    ):
        return float(value[0]), float(value[1]), float(value[2])
    raise DataError(f"{path}: up is {value!r}, expected three numbers of length 1")


def write_scene_file(folder: Path, scene: SceneFile) -> None:
    """Write folder/scene.toml, in one step.

    Args:
        folder: The scene's folder, which exists.
        scene: What to write; tables are sorted by key.
    """
    lines = [f"units = {_text(scene.units)}"]
    if scene.up is not None:
        lines.append(f"up = [{', '.join(repr(float(x)) for x in scene.up)}]")
    for name, table in (("facts", scene.facts), ("left_out", scene.left_out)):
        lines += [
            "",
            f"[{name}]",
            *(f"{_text(key)} = {_text(table[key])}" for key in sorted(table)),
        ]
    part = folder / f".{NAME}.part"
    part.write_text("\n".join(lines) + "\n")
    os.replace(part, folder / NAME)


def _text(value: str) -> str:
    """Quote a string: JSON's escapes are TOML's too, DEL apart, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
