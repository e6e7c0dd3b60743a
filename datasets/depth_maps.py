"""True depth beside the photos of scenes that have it: depth/<photo's stem>.npz."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.array_files import read_arrays

FOLDER = "depth"
KEY = "depth"
"""Array of the .npz: float32 z-depth in scene units through pixel centres, inf: nothing there."""


def depth_path(scene: Path, name: str) -> Path:
    """Path of the file that has a view's true depth, whether it exists or not.

    Args:
        scene: The scene's folder.
        name: Name of the photo inside the photo folder.
    """
    return (scene / FOLDER / name).with_suffix(".npz")


def depth_loader(
    scene: Path, name: str, photo_size: tuple[int, int], size: tuple[int, int]
) -> Callable[[], Float[Tensor, "h w"]] | None:
    """How to read a view's true depth, or None where the scene has no file for it.

    Only for photos that are pinhole images already: depth is not undistorted.

    Args:
        scene: Scene folder.
        name: Name of the photo.
        photo_size: (width, height) of the photo, which the file must have.
        size: (width, height) of the view. A smaller view takes the depth at the photo's pixel
            that holds its own pixel's centre: means over edges would be depths of nothing.
    """
    path = depth_path(scene, name)
    return partial(_read, path, photo_size, size) if path.is_file() else None


def _read(path: Path, photo_size: tuple[int, int], size: tuple[int, int]) -> Float[Tensor, "h w"]:
    (depth,) = read_arrays(path, KEY)
    if depth.shape != photo_size[::-1] or depth.dtype != np.float32:
        raise DataError(
            f"{path}: depth is {depth.dtype} {depth.shape[::-1]}, its photo is {photo_size}; "
            "expected float32 of the photo's size"
        )
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(int)
        for new, old in zip(size[::-1], photo_size[::-1], strict=True)
    )
    return torch.from_numpy(depth[rows[:, None], columns])
