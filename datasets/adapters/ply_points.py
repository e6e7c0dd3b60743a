"""Sparse points from a PLY file with colours."""

from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.ply import read_vertices
from splatproof.datasets.layout import plain_points
from splatproof.reference.types.scene import SparsePoints


def read_ply_points(path: Path) -> SparsePoints:
    """Vertices x, y, z with red, green, blue as uint8; without colours mid grey.

    Raises: DataError naming the file and the fault.
    """
    if not path.exists():
        raise DataError(f"{path}: missing; the scene's file of cameras names it")
    vertices = read_vertices(path).rows
    missing = [axis for axis in "xyz" if axis not in (vertices.dtype.names or ())]
    if missing:
        raise DataError(f"{path}: vertices have no property {missing[0]!r}, expected x, y, z")
    positions = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
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
