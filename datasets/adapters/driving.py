"""What the adapters of driving data share: tables of numbers, LiDAR files, cameras of a car."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, read_text
from splatproof.datasets.layout import Hits, SweepFile

FRAME_SECONDS = 0.1
"""KITTI and Waymo take 10 frames a second; used where an export has no timestamps."""
UP = (0.0, 0.0, 1.0)
"""Both worlds are z-up, in metres."""


def read_numbers(path: Path, count: int) -> Float64[np.ndarray, " n"]:
    """The numbers of a text file, separated by white space.

    Args:
        path: The file.
        count: How many there must be.
    Raises: DataError naming the file and what it has.
    """
    words = read_text(path).split()
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise DataError(f"{path}: has {len(words)} words, expected {count} finite numbers")
    return values


def read_table(path: Path) -> dict[str, Float64[np.ndarray, " n"]]:
    """Lines "key: numbers" (the colon may be missing); lines of other words are left out.

    Raises: DataError if the file is missing or is not text.
    """
    table = {}
    for line in read_text(path).splitlines():
        key, _, rest = line.strip().partition(" ")
        try:
            table[key.rstrip(":")] = np.array(rest.split(), dtype=np.float64)
        except ValueError:
            continue
    return table


def entry(
    path: Path, table: dict[str, Float64[np.ndarray, " n"]], names: Sequence[str], *shape: int
) -> Float64[np.ndarray, "..."]:
    """A matrix of a table, looked up under the names that different releases give it.

    Args:
        path: The table's file, for errors.
        table: As `read_table` returns it.
        names: Keys to try in this order.
        shape: Rows and columns of the matrix, whose numbers stand row by row.
    Returns: The matrix under the first name that the table has.
    Raises: DataError naming the file and the key.
    """
    for name in names:
        if name in table:
            values = table[name]
            if len(values) != np.prod(shape) or not np.isfinite(values).all():
                raise DataError(
                    f"{path}: {name} has {len(values)} numbers, expected {np.prod(shape)} finite ones"
                )
            return values.reshape(shape)
    raise DataError(f"{path}: has no {' or '.join(names)}")


def homogeneous(matrix: Float64[np.ndarray, "3 4"]) -> Float64[np.ndarray, "4 4"]:
    """A 3 x 4 motion as 4 x 4."""
    return np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])


def sweep(
    path: Path,
    time: float,
    to_world: Float64[np.ndarray, "4 4"],
    columns: int,
    first: int,
    sensor: int | tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> SweepFile:
    """A LiDAR file of float32 rows.

    Args:
        path: The file; it is read when asked for.
        time: Seconds from the same start as the photos' times.
        to_world: Motion from the file's frame to the scene's.
        columns: Numbers in a row.
        first: Index of the column of x; y and z follow.
        sensor: Where the sensor is in the file's frame, or the index of the column of x of each
            ray's own sensor, y and z after it: the median is where the one with most rays is.
    """
    return SweepFile(
        time=time, path=path, read=partial(_hits, path, to_world, columns, first, sensor)
    )


def _hits(
    path: Path,
    to_world: Float64[np.ndarray, "4 4"],
    columns: int,
    first: int,
    sensor: int | tuple[float, float, float],
) -> Hits:
    if not path.is_file():
        raise DataError(
            f"{path}: LiDAR sweep is missing; put it back, or open the scene again to go without"
        )
    data = read_bytes(path)
    size = len(data)
    if not size or size % (4 * columns):
        raise DataError(
            f"{path}: has {size} bytes, expected a multiple of {4 * columns} above 0 "
            f"({columns} float32 a point); the file is cut short or of another kind"
        )
    rows = np.frombuffer(data, dtype="<f4").reshape(-1, columns)
    points = rows[:, first : first + 3].astype(np.float64)
    origin = np.array(sensor, np.float64)
    if isinstance(sensor, int):
        origin = np.median(rows[:, sensor : sensor + 3].astype(np.float64), axis=0)
    if not (np.isfinite(points).all() and np.isfinite(origin).all()):
        raise DataError(f"{path}: has a point that is not finite")
    rotation, place = to_world[:3, :3], to_world[:3, 3]
    return Hits(points @ rotation.T + place, rotation @ origin + place)


def frame_names(folder: Path) -> list[str]:
    """Stems of the .txt files of a folder, one a frame; time follows from their order.

    Raises: DataError if they are no whole numbers without a gap.
    """
    # 999 before 1000, however many digits an export pads to
    names = sorted((path.stem for path in folder.glob("*.txt")), key=lambda n: (len(n), n))
    for name, after in pairwise([*names, ""]):
        if not name.isdecimal():
            raise DataError(f"{folder / name}.txt: expected a frame's number for a name")
        if after.isdecimal() and int(after) != int(name) + 1:
            missing = folder / f"{int(name) + 1:0{len(name)}d}.txt"
            raise DataError(f"{missing}: missing, but {after} comes after it; export it again")
    return names


def present(frames: Sequence[str], find: Callable[[str], Path]) -> list[tuple[int, Path]]:
    """The frames whose file is there: sets lack single sweeps.

    Args:
        frames: Names of all frames, in order of time.
        find: Path of the file that a frame should have.
    Returns: (index of the frame, its file) for each file that exists.
    """
    files = [(i, find(frame)) for i, frame in enumerate(frames)]
    return [(i, path) for i, path in files if path.is_file()]
