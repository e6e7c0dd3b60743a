"""scene.toml: what is known of a scene folder beyond its COLMAP model. Written by `bench ingest`."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from splatproof.base.errors import DataError
from splatproof.base.files import write_text
from splatproof.base.typed_toml import build, read_toml

NAME = "scene.toml"


@dataclass(frozen=True, kw_only=True)
class SceneFile:
    """The contents of scene.toml."""

    units: Literal["metres", "sfm"] = "sfm"
    """Name of the length unit."""
    up: tuple[float, float, float] | None = None
    """Unit vector against gravity in the model's frame; None: unknown."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Photo name: why it is not in the model."""
    facts: dict[str, str] = field(default_factory=dict)
    """How the scene was made."""

    def __post_init__(self) -> None:
        """Check the direction."""
        if self.up is not None and not abs(math.hypot(*self.up) - 1) < 1e-6:
            raise DataError(f"up is {list(self.up)}, expected three numbers of length 1")


def read_scene_file(folder: Path) -> SceneFile:
    """Read folder/scene.toml; a scene folder without one is described by the defaults.

    Raises: DataError if the file is not TOML or a field is not what it must be.
    """
    path = folder / NAME
    if not path.exists():
        return SceneFile()
    return build(SceneFile, read_toml(path, DataError), str(path), DataError)


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
    write_text(folder / NAME, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    """Quote a string: JSON's escapes are TOML's too, DEL apart, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
