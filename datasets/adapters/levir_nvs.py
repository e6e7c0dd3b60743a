"""LEVIR-NVS: Images/NNN.png with Cams/NNN.txt, world to camera in OpenCV axes."""

import re
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import read_text
from splatproof.datasets.adapters.posed import checked_pose, pinhole_camera, positive
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.photos import list_photos, photo_size
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / "Cams").is_dir() and (folder / "Images").is_dir()


def open_levir_nvs(folder: Path, protocol: Protocol) -> Scene:
    """Read a scene: a camera file has "extrinsic", 4 x 4, "intrinsic", 3 x 3, depth range.

    Numbers are separated by commas or spaces. The set ships no split in a scene's folder: the
    protocol's holds. No sparse points.

    Args:
        folder: The scene's folder, with Cams and Images.
        protocol: Image sizes, and which views are held out.
    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    Source: Wu et al. 2022 (ImMPI), data release.
    """
    cameras = sorted((folder / "Cams").glob("*.txt"))
    photos = [_photo(folder, path) for path in cameras]
    known = {path.stem for path in cameras}
    layout = Layout(
        adapter="levir-nvs",
        photos=photos,
        description=cameras or [folder / "Cams"],
        left_out=tuple(
            (name, "no camera in Cams")
            for name in list_photos(folder / "Images")
            if Path(name).stem not in known
        ),
    )
    return open_layout(folder, layout, protocol)


def _photo(folder: Path, path: Path) -> PosedPhoto:
    words = re.split(r"[,\s]+", read_text(path).strip())
    try:
        if (words[0], words[17]) != ("extrinsic", "intrinsic"):
            raise ValueError
        extrinsic = np.array(words[1:17], dtype=np.float64).reshape(4, 4)
        K = np.array(words[18:27], dtype=np.float64).reshape(3, 3)
    except (ValueError, IndexError):
        raise DataError(
            f"{path}: not a camera of LEVIR-NVS; expected the word extrinsic, 16 numbers, the word "
            "intrinsic, 9 numbers"
        ) from None
    world_to_camera = checked_pose(extrinsic, str(path))
    rotation = world_to_camera[:, :3].T
    if abs(K[0, 1]) > 1e-6:
        raise DataError(f"{path}: intrinsic has skew {K[0, 1]}, expected 0")
    fx, fy, cx, cy = (
        positive(float(value), str(path), "intrinsic")
        for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    )
    file = folder / "Images" / f"{path.stem}.png"
    return PosedPhoto(
        name=file.name,
        path=file,
        camera=pinhole_camera(*photo_size(file), fx, fy, cx, cy),
        camera_to_world=np.concatenate([rotation, -rotation @ world_to_camera[:, 3:]], axis=1),
    )
