"""Completed depths kept beside a checkpoint, with all that was told while they were made."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.contracts.run import Run
from splatproof.reference.types.scene import SparsePoints


def kept_points(
    path: Path | None, key: str, run: Run, make: Callable[[Run], SparsePoints]
) -> SparsePoints:
    """The points of this very run, where they are there; else they are made, and kept.

    Lines and facts that the run was told while they were made it is told again where they are taken, so that a
    record says the same of a run that was killed.

    Args:
        path: File they are kept in; None: nowhere.
        key: What they depend on.
        run: Who is told.
        make: Makes them; given the run that is to be told.

    Raises: As `make`; OSError where the disk does not take them.
    """
    kept = None if path is None else _read(path, key)
    if kept is not None:
        points, held = kept
        for line in held["lines"]:
            run.say(line)
        for name, value in held["facts"].items():
            run.on_fact(name, value)
        return points
    lines, facts = list[str](), dict[str, str]()

    def say(line: str) -> None:
        lines.append(line)
        run.say(line)

    def on_fact(name: str, value: str) -> None:
        facts[name] = value
        run.on_fact(name, value)

    points = make(replace(run, say=say, on_fact=on_fact))
    if path is not None:
        write_tensors(path, vars(points), {"key": key, "lines": lines, "facts": facts})
    return points


def _read(path: Path, key: str) -> tuple[SparsePoints, dict[str, Any]] | None:
    """Points and what was told of them; None where they are not there, damaged, of another run, or nothing was kept of
    what was told."""
    if not path.is_file():
        return None
    try:
        tensors, held = read_tensors(path)
    except DataError:  # cut short by a full disk: it is only a copy of what can be made again
        return None
    whole = isinstance(held, dict) and held.keys() == {"key", "lines", "facts"}
    return (SparsePoints(**tensors), held) if whole and held["key"] == key else None
