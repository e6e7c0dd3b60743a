"""LLFF: poses_bounds.npy, a row of 17 numbers for each photo in the order of the sorted names."""

import tokenize
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import size_of
from splatproof.base.numbers import image_size
from splatproof.datasets.adapters.posed import checked_pose, pinhole_camera, positive
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.colmap import photo_folder
from splatproof.datasets.layout import Layout, PosedPhoto, copy_factor
from splatproof.datasets.photos import list_photos
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

FILE = "poses_bounds.npy"
DAMAGED = (
    OSError, ValueError, TypeError, SyntaxError, tokenize.TokenError, EOFError, MemoryError, RecursionError,
)  # fmt: skip
"""What numpy says to a file that is none of its own; it reads the header as Python."""
COLUMNS = 17
"""A 3 x 5 matrix by rows, camera to world beside (height, width, focal length); near; far."""


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout. (The releases have a COLMAP model too, which goes first.)"""
    return (folder / FILE).is_file()


def open_llff(folder: Path, protocol: Protocol) -> Scene:
    """Read a scene: camera axes down, right, back; one focal length, principal point central.

    Sizes are those of the folder images; copies in images_N are N times smaller, their names may
    have another ending, so the n-th photo of a folder is the n-th row. No sparse points; the
    least near and greatest far bound become the fact `depth_bounds`.

    Args:
        folder: The scene's folder, with poses_bounds.npy and folders of photos.
        protocol: Folder of photos, image sizes, and which views are held out.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Mildenhall et al. 2019 (LLFF), release: llff/poses/pose_utils.py and README.
    """
    path = folder / FILE
    size_of(path)
    try:
        rows = np.load(path, allow_pickle=False)
    except DAMAGED as error:
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: not an array of numpy.save ({said})") from None
    if rows.ndim != 2 or rows.shape[1] != COLUMNS or not np.isfinite(rows).all():
        raise DataError(
            f"{path}: has shape {rows.shape}, expected rows of {COLUMNS} finite numbers"
        )
    photos = photo_folder(folder, protocol)
    names = list_photos(photos)
    if len(names) != len(rows):
        raise DataError(
            f"{path}: has {len(rows)} rows, but {photos} has {len(names)} photos; rows belong to "
            "photos by their order, so both must be the same"
        )
    layout = Layout(
        adapter="llff",
        photos=[
            _photo(photos / name, name, row.astype(np.float64), f"{path}: row {i} ({name})")
            for i, (name, row) in enumerate(zip(names, rows, strict=True))
        ],
        description=[path],
        facts={
            "image_folder": photos.name,
            "depth_bounds": f"{rows[:, 15].min():.6g} to {rows[:, 16].max():.6g}",
        },
    )
    return open_layout(folder, layout, protocol)


def _photo(path: Path, name: str, row: np.ndarray, where: str) -> PosedPhoto:
    matrix = row[:15].reshape(3, 5)
    height, width, focal = (
        positive(float(value), where, key)
        for key, value in zip(("height", "width", "focal length"), matrix[:, 4], strict=True)
    )
    down, right, back, centre = matrix[:, :4].T
    pose = np.stack([right, down, -back, centre], axis=1)
    width, height = image_size(round(width), round(height), where)
    return PosedPhoto(
        name=name,
        path=path,
        camera=pinhole_camera(width, height, focal, focal, width / 2, height / 2),
        camera_to_world=checked_pose(pose, where),
        factor=copy_factor(path.parent.name),
    )
