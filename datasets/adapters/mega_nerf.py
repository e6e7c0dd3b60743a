"""Mega-NeRF's layout of Mill-19 and UrbanScene3D: a small .pt file with the camera of each photo.

The world's axes are down, right, back; the camera's right, up, back; positions are centred on
`origin_drb` and divided by `pose_scale_factor`. We undo both and keep the world's axes.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.files import read_text, size_of
from splatproof.base.memory import check_room
from splatproof.base.numbers import image_size
from splatproof.datasets.adapters.posed import (
    OPENGL_TO_OPENCV,
    checked_pose,
    find_photo,
    pinhole_camera,
    positive,
)
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.photos import list_photos
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

SPLITS: dict[str, Literal["train", "test"]] = {"train": "train", "val": "test"}
SUFFIXES = (".jpg", ".JPG", ".png", ".PNG")


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / "train" / "metadata").is_dir()


def open_mega_nerf(folder: Path, protocol: Protocol) -> Scene:
    """Read a scene in Mega-NeRF's layout; the folder val is the test split.

    The photos are undistorted already (the key `distortion` tells of the originals). The set
    has no sparse points. Positions are metres; up is -x, exactly.

    Args:
        folder: The scene's folder, with coordinates.pt, train and val.
        protocol: Image sizes; the split is the set's, unless it names the test views.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Turki et al. 2022, release: scripts/colmap_to_mega_nerf.py, mega_nerf/ray_utils.py.
    """
    coordinates = folder / "coordinates.pt"
    table = _load(coordinates)
    scale = positive(_plain(table.get("pose_scale_factor")), str(coordinates), "pose_scale_factor")
    origin = table.get("origin_drb")
    if not isinstance(origin, torch.Tensor) or origin.shape != (3,) or not origin.isfinite().all():
        raise DataError(f"{coordinates}: origin_drb is {origin!r}, expected three finite numbers")
    photos, files, left_out = [], [coordinates], []
    for name, split in SPLITS.items():
        metadata = sorted((folder / name / "metadata").glob("*.pt"))
        files += metadata
        for path in metadata:
            photos.append(_photo(folder, path, split, origin.double().numpy(), scale))
        known = {path.stem for path in metadata}
        rgbs = folder / name / "rgbs"
        left_out += [
            (f"{name}/rgbs/{photo}", f"no camera in {name}/metadata")
            for photo in (list_photos(rgbs) if rgbs.is_dir() else [])
            if Path(photo).stem not in known
        ]
    _check_mappings(folder / "mappings.txt", {path.name for path in files[1:]})
    layout = Layout(
        adapter="mega-nerf",
        photos=photos,
        description=files,
        up=(-1.0, 0.0, 0.0),
        units="metres",
        left_out=tuple(left_out),
    )
    return open_layout(folder, layout, protocol)


def _photo(
    folder: Path,
    path: Path,
    split: Literal["train", "test"],
    origin: Float64[np.ndarray, "3"],
    scale: float,
) -> PosedPhoto:
    data = _load(path)
    width, height = image_size(_plain(data.get("W")), _plain(data.get("H")), str(path))
    values = _plain(data.get("intrinsics"))
    if not isinstance(values, list) or len(values) != 4:
        raise DataError(f"{path}: intrinsics is {values!r}, expected fx, fy, cx, cy")
    fx, fy, cx, cy = (positive(value, str(path), "intrinsics") for value in values)
    pose = checked_pose(_plain(data.get("c2w")), str(path))
    pose[:, :3] = pose[:, :3] @ OPENGL_TO_OPENCV
    pose[:, 3] = pose[:, 3] * scale + origin
    file = find_photo(path.parent.parent / "rgbs" / path.stem, SUFFIXES, lambda: str(path))
    return PosedPhoto(
        name=file.relative_to(folder).as_posix(),
        path=file,
        camera=pinhole_camera(width, height, fx, fy, cx, cy),
        camera_to_world=pose,
        split=split,
    )


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, torch.Tensor) else value


def _load(path: Path) -> dict[str, object]:
    """The table of a .pt file; only plain values and tensors are unpickled."""
    check_room(path, size_of(path))
    try:
        table = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # noqa: BLE001 - a damaged pickle raises whatever its bytes lead to
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: not a file of torch.save with plain values ({said})") from None
    if not isinstance(table, dict):
        raise DataError(f"{path}: holds {type(table).__name__}, expected a dict")
    return table


def _check_mappings(path: Path, known: set[str]) -> None:
    """Every camera that mappings.txt lists must be there; the file itself may be missing."""
    if not path.is_file():
        return
    lines = read_text(path).splitlines()
    if not any(line.strip() for line in lines):
        raise DataError(f"{path}: lists no camera; unpack it again, or remove it")
    for number, line in enumerate(lines, 1):
        name = line.rpartition(",")[2].strip()
        if line.strip() and name not in known:
            raise DataError(f"{path}: line {number} lists {name!r}, found in no metadata folder")
