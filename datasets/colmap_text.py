"""Walks COLMAP's text model files line by line (layout: COLMAP, "Output Format")."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes
from splatproof.base.numbers import LARGEST
from splatproof.datasets.colmap_index import ModelIndex, parameter_count

SUFFIX = ".txt"
NAMES = {"cameras": "cameras", "images": "images", "points3D": "points"}
"""What the header of each file calls what it counts."""


def _lines(path: Path, *, keep_empty: bool = False) -> Iterator[tuple[str, str]]:
    """(place, text) of every line that is no comment; empty lines only where they mean something."""
    # not splitlines: COLMAP ends lines at line feeds alone, Python at form feeds and others too
    for number, line in enumerate(_text(path).removesuffix("\n").split("\n"), start=1):
        if not line.startswith("#") and (keep_empty or line.strip()):
            yield f"{path}: line {number}", line.strip()


def _text(path: Path) -> str:
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not text; a binary model ends in .bin") from None


def _check_count(path: Path, kind: str, found: int) -> None:
    """What COLMAP's header counts must be there: a file that was cut between lines looks whole."""
    text = _text(path)
    said = re.search(rf"^# Number of {kind}: (\d{{1,18}})\b", text, re.MULTILINE)
    if said and not text.endswith("\n"):  # COLMAP, which wrote the header, ends every line
        raise DataError(f"{path}: ends in the middle of a line; it is cut short, copy it again")
    if said and int(said[1]) != found:
        raise DataError(
            f"{path}: has {found} {kind}, its header says {said[1]}; it is cut short or edited, copy "
            "it again or correct the header"
        )


def _numbers(place: str, fields: list[str], kind: type[int] | type[float]) -> list:
    """Fields as whole or real numbers."""
    numbers = [_number(field, kind) for field in fields]
    if None in numbers:
        found = fields[numbers.index(None)]
        expected = "a whole number from 0 to 2^63 - 1" if kind is int else "a number"
        raise DataError(f"{place}: found {found[:40]!r} instead of {expected}")
    return numbers


def _number(field: str, kind: type[int] | type[float]) -> int | float | None:
    """The number that a field says; None for none. COLMAP's whole numbers have no sign."""
    try:
        number = kind(field)
    except ValueError:
        return None
    return number if kind is float or 0 <= number <= LARGEST else None


def _expect(place: str, fields: list[str], count: int, layout: str) -> None:
    if len(fields) < count:
        raise DataError(f"{place}: has {len(fields)} fields, expected {layout}; it is cut short")


def _cameras(path: Path) -> list[int]:
    ids = []
    for place, line in _lines(path):
        fields = line.split()
        _expect(place, fields, 4, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
        ids += _numbers(place, fields[:1], int)
        _numbers(place, fields[2:4], int)
        count = parameter_count(path, fields[1])
        if len(_numbers(place, fields[4:], float)) != count:
            raise DataError(f"{place}: {fields[1]} has {count} parameters, found {len(fields) - 4}")
    return ids


def _images(path: Path) -> list[tuple[int, str, int, int]]:
    images = []
    lines = list(_lines(path, keep_empty=True))
    if len(lines) % 2 and not lines[-1][1]:
        lines.pop()  # an empty line at the end of the file is no image's list of points
    if len(lines) % 2:
        raise DataError(f"{path}: has {len(lines)} lines, expected two for each image")
    for (place, line), (place2, line2) in zip(lines[::2], lines[1::2], strict=True):
        fields, points = line.split(None, 9), line2.split()  # the name may have blanks
        _expect(place, fields, 10, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        number, camera = _numbers(place, [fields[0], fields[8]], int)
        _numbers(place, fields[1:8], float)
        if len(_numbers(place2, points, float)) % 3:
            raise DataError(
                f"{place2}: has {len(points)} fields, expected (X Y POINT3D_ID) triples"
            )
        images.append((number, fields[9], camera, len(points) // 3))
    return images


def _points(path: Path) -> list[tuple[int, list[float], list[int], list[int]]]:
    """Id, position, colour and track of each."""
    points = []
    for place, line in _lines(path):
        fields = line.split()
        _expect(place, fields, 8, "POINT3D_ID X Y Z R G B ERROR TRACK")
        *position, _ = _numbers(place, fields[1:4] + fields[7:8], float)
        number, *others = _numbers(place, fields[:1] + fields[4:7] + fields[8:], int)
        colour, track = others[:3], others[3:]
        if len(track) % 2:
            raise DataError(f"{place}: the track has {len(track)} fields, expected pairs")
        points.append((number, position, colour, track))
    return points


def image_names(folder: Path) -> list[str]:
    """Names of the images of a model. Raises: DataError as `index_text`."""
    return [name for _, name, _, _ in _images(folder / "images.txt")]


def index_text(folder: Path) -> ModelIndex:
    """Walk cameras.txt, images.txt, points3D.txt and, where they are, rigs.txt and frames.txt.

    Raises: DataError naming file, line and field.
    """
    cameras = _cameras(folder / "cameras.txt")
    images = _images(folder / "images.txt")
    points = _points(folder / "points3D.txt")
    for name, found in (("cameras", cameras), ("images", images), ("points3D", points)):
        _check_count(folder / f"{name}.txt", NAMES[name], len(found))
    for name, least in (("rigs", 4), ("frames", 10)):
        if (folder / f"{name}.txt").exists():
            for place, line in _lines(folder / f"{name}.txt"):
                _expect(place, line.split(), least, f"at least {least} fields of a {name[:-1]}")
    ids, positions, colours, members = zip(*points, strict=True) if points else ((),) * 4
    tracks = np.array([i for track in members for i in track], dtype=np.int64).reshape(-1, 2)
    return ModelIndex(
        cameras=cameras,
        image_ids=[image[0] for image in images],
        image_names=[image[1] for image in images],
        image_cameras=[image[2] for image in images],
        image_observations=[image[3] for image in images],
        point_ids=np.array(ids, dtype=np.uint64),
        positions=np.array(positions, dtype=np.float64).reshape(-1, 3),
        # COLMAP keeps the lowest eight bits, too
        colours=np.array(colours, dtype=np.int64).astype(np.uint8).reshape(-1, 3),
        track_lengths=np.array([len(track) // 2 for track in members], dtype=np.int64),
        track_images=tracks[:, 0],
        track_observations=tracks[:, 1],
    )
