"""Frozen results as a small file in the repository: baselines/NAME.json."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import read_json, write_text
from splatproof.base.typed_toml import build
from splatproof.reference.types.result_json import NON_FINITE
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.sides import Side
from splatproof.reports.measured import Measured

FOLDER = Path("baselines")
"""Where baselines are saved by name, below the current folder."""
FORMAT, VERSION = "splatproof baseline", 1
"""What the file says it is; a reader refuses every other version."""
SHARED = ("settings", "rules", "environment", "data", "truth")
"""Parts that many cases have alike; each different one is written once."""
AGAIN = "save it again with `bench baseline save`, or take the committed one back from git"


def write(path: Path, cases: Sequence[CaseRecord]) -> None:
    """Write a baseline file: a line a case, and a line for each part that cases share.

    The same cases give the same bytes, so that saving again what has not changed changes nothing.

    Args:
        path: The file; one that is there is replaced.
        cases: Cases of a side, at least one.
    """
    shared: dict[str, list[Any]] = {name: [] for name in SHARED}
    lines = []
    for case in sorted(cases, key=lambda one: one.name):
        plain = {f.name: getattr(case, f.name) for f in fields(case) if f.name != "pictures"}
        plain["measured"] = _packed(case.measured)
        plain["settings"] = _named(plain["settings"])
        for name in SHARED:
            if plain[name] not in shared[name]:
                shared[name].append(plain[name])
            plain[name] = shared[name].index(plain[name])
        lines.append(plain)
    body = {**shared, "cases": lines}
    head = {"format": FORMAT, "version": VERSION, "sha256": checksum(body)}
    blocks = [f'"{name}": {_line(value)}' for name, value in head.items()]
    blocks += [
        f'"{name}": [\n' + ",\n".join(map(_line, values)) + "\n]" for name, values in body.items()
    ]
    write_text(path, "{\n" + ",\n".join(blocks) + "\n}\n")


def read(path: Path, label: str) -> Side:
    """The side that a baseline file holds; it has no pictures.

    Args:
        path: The file.
        label: What people call the side.
    Raises: DataError naming the file where it is missing, damaged, edited or of another version.
    """
    found = read_json(path)
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise DataError(f"{path}: no baseline; expected a file that `bench baseline save` wrote")
    if found.get("version") != VERSION:
        raise DataError(
            f"{path}: baseline version {found.get('version')!r}, this release reads {VERSION}; {AGAIN}"
        )
    body = {name: found.get(name) for name in (*SHARED, "cases")}
    try:
        sealed = checksum(body)
    except ValueError:  # 1e999 is JSON, and reads as infinite
        raise DataError(f"{path}: it holds a number that is not finite; {AGAIN}") from None
    if found.get("sha256") != sealed:
        raise DataError(
            f"{path}: its content does not fit its checksum, so it was edited or badly merged; {AGAIN}"
        )
    try:
        cases = tuple(_case(path, number, body) for number, _ in enumerate(body["cases"] or ()))
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: damaged ({type(error).__name__}: {error}); {AGAIN}") from None
    return Side(label=label, cases=cases)


def names(folder: Path = FOLDER) -> list[str]:
    """Names of the baselines in a folder, sorted.

    Args:
        folder: Where baselines are saved.
    """
    return sorted(path.stem for path in folder.glob("*.json")) if folder.is_dir() else []


def path_of(name: str, folder: Path = FOLDER) -> Path:
    """The file of a baseline.

    Args:
        name: Its name.
        folder: Where baselines are saved.
    Raises: UsageError for a name that would be another folder's file.
    """
    if not name or name != Path(name).name or name.startswith("."):
        raise UsageError(f"baseline name {name!r}: expected a plain name such as quick")
    return folder / f"{name}.json"


def _packed(run: Measured) -> dict[str, Any]:
    """A case's numbers with the names of its images' metrics written once."""
    plain: dict[str, Any] = asdict(run)
    if math.isinf(run.late_gain):  # JSON has no such number
        del plain["late_gain"]
    plain["settings"] = _named(plain["settings"])
    metrics = sorted({name for scores in run.images.values() for name in scores})
    plain["images"] = {
        "metrics": metrics,
        "scores": {
            image: [scores.get(name) for name in metrics] for image, scores in run.images.items()
        },
    }
    return plain


def _unpacked(plain: Mapping[str, Any]) -> dict[str, Any]:
    packed = plain["images"]
    images = {
        image: {
            name: score
            for name, score in zip(packed["metrics"], scores, strict=True)
            if score is not None
        }
        for image, scores in packed["scores"].items()
    }
    plain = {name: _numbered(part) if name == "settings" else part for name, part in plain.items()}
    return {"late_gain": math.inf, **plain, "images": images}


def _named(value: Any) -> Any:
    """A setting with names in place of the numbers that JSON does not have, as records have them."""
    if isinstance(value, Mapping):
        return {name: _named(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_named(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return next(name for name, number in NON_FINITE.items() if str(number) == str(value))
    return value


def _numbered(value: Any) -> Any:
    """What `_named` was given."""
    if isinstance(value, dict):
        return {name: _numbered(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_numbered(part) for part in value]
    return NON_FINITE.get(value, value) if isinstance(value, str) else value


def _case(path: Path, number: int, body: Mapping[str, Any]) -> CaseRecord:
    plain = dict(body["cases"][number])
    where = f"{path}: cases[{number}]"
    plain |= {name: body[name][plain[name]] for name in SHARED}
    plain["settings"] = _numbered(plain["settings"])
    run = _unpacked(plain.pop("measured"))
    return CaseRecord(measured=build(Measured, run, f"{where}.measured", DataError), **plain)


def _line(value: object) -> str:
    """Strict JSON on one line, the same for the same value."""
    return json.dumps(
        value, allow_nan=False, ensure_ascii=False, sort_keys=True, separators=(",", ":")
    )


def checksum(body: object) -> str:
    """Hash of everything in a baseline file but its head.

    Args:
        body: The parts that cases share, and the cases, by name.
    """
    return hashlib.sha256(_line(body).encode("utf-8", "surrogatepass")).hexdigest()
