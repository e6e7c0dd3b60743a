"""Sparse points from a PLY file with colours."""

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyParseError

from splatproof.base.errors import DataError
from splatproof.base.files import size_of
from splatproof.datasets.layout import plain_points
from splatproof.reference.types.scene import SparsePoints


def read_ply_points(path: Path) -> SparsePoints:
    """Vertices x, y, z with red, green, blue as uint8; without colours mid grey.

    Raises: DataError naming the file and the fault.
    """
    if not path.exists():
        raise DataError(f"{path}: missing; the scene's file of cameras names it")
    size_of(path)
    try:
        vertices = PlyData.read(path)["vertex"].data
        positions = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    except (PlyParseError, KeyError, ValueError, OSError, MemoryError, OverflowError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: not a PLY file with vertices x, y, z ({said})") from None
    if not np.isfinite(positions).all():
        raise DataError(f"{path}: a vertex is not finite; expected numbers")
    colours = np.full((len(positions), 3), 128, np.uint8)
    names = ("red", "green", "blue")
    if set(names) <= set(vertices.dtype.names or ()):
        channels = [vertices[name] for name in names]
        if any(channel.dtype != np.uint8 for channel in channels):
            raise DataError(f"{path}: colours are {channels[0].dtype}, expected uchar")
        colours = np.stack(channels, axis=1)
    return plain_points(positions, np.ascontiguousarray(colours))
