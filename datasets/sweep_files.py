"""LiDAR sweeps in a scene folder of ours: lidar/*.npz beside views.json.

An .npz has `points` (n x 3, the scene's frame), `origin` (3, where the sensor was) and `time` (seconds
from the same start as those in views.json).
"""

from functools import partial
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.datasets.array_files import read_arrays
from splatproof.datasets.layout import Hits, SweepFile

FOLDER = "lidar"


def list_sweeps(scene: Path) -> list[SweepFile]:
    """The sweeps of a folder in order of time; of each file only the time is read.

    Args:
        scene: The scene's folder.
    Raises: DataError naming a file whose time cannot be read.
    """
    files = sorted((scene / FOLDER).glob("*.npz"))
    sweeps = [SweepFile(time=_time(path), path=path, read=partial(_read, path)) for path in files]
    return sorted(sweeps, key=lambda sweep: sweep.time)


def _time(path: Path) -> float:
    (time,) = read_arrays(path, "time")
    if time.shape != () or time.dtype.kind not in "fiu" or not np.isfinite(time):
        raise DataError(
            f"{path}: time is {time.dtype} of shape {time.shape}, expected one finite number of "
            "seconds; make the scene again"
        )
    return float(time)


def _read(path: Path) -> Hits:
    points, origin = read_arrays(path, "points", "origin")
    for name, array, shape in (("points", points, (len(np.atleast_1d(points)), 3)),
                               ("origin", origin, (3,))):  # fmt: skip
        if array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise DataError(
                f"{path}: {name} is {array.dtype} of shape {array.shape}, expected finite floats, "
                "three a point; make the scene again"
            )
    return Hits(points.astype(np.float64), origin.astype(np.float64))
