"""Finds and reads a COLMAP model, checked before and after COLMAP's own reader."""

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes
from splatproof.datasets import colmap_binary, colmap_text
from splatproof.datasets.colmap_index import (
    MODEL_FILES,
    RIG_FILES,
    ModelIndex,
    check_references,
)
from splatproof.datasets.colmap_library import has_focal_length, pycolmap

MODEL_FOLDERS = ("sparse/0", "sparse")
_READERS = (
    (colmap_binary.SUFFIX, colmap_binary.index_binary),
    (colmap_text.SUFFIX, colmap_text.index_text),
)

_NAMERS = (
    (colmap_binary.SUFFIX, colmap_binary.image_names),
    (colmap_text.SUFFIX, colmap_text.image_names),
)
_UNIT = 1e-3
"""How far a quaternion's length may be from 1: text files round to a few digits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """A sound COLMAP model: ids answer to each other, every number that is used is finite."""

    folder: Path
    reconstruction: pycolmap.Reconstruction
    index: ModelIndex
    images: tuple[pycolmap.Image, ...]
    """Registered images, sorted by name."""
    sha256: str
    """Hash of the names and bytes of all model files, in hex."""


def find_model(scene: Path) -> Path:
    """Folder of a scene's COLMAP model: sparse/0, else sparse.

    Raises: DataError listing what was looked for.
    """
    for name in MODEL_FOLDERS:
        for suffix, _ in _READERS:
            if any((scene / name / f"{file}{suffix}").is_file() for file in MODEL_FILES):
                return scene / name
    raise DataError(
        f"{scene}: no COLMAP model; looked for cameras, images and points3D (.bin or .txt) in "
        f"{' and '.join(MODEL_FOLDERS)}; run `bench ingest` or `colmap mapper` first"
    )


def other_models(used: Path) -> dict[str, list[str]]:
    """Names of the images of the models beside one, by the name of their folder.

    Structure from motion that cannot join all photos writes sparse/0, sparse/1 and so on, of which
    the first need not be the largest. One that cannot be read is passed over.

    Args:
        used: Folder of the model that is used.
    """
    found = {}
    for folder in sorted(used.parent.iterdir()) if used.name.isdecimal() else ():
        for suffix, names in _NAMERS:
            there = folder != used and folder.name.isdecimal() and folder.name not in found
            if there and (folder / f"images{suffix}").is_file():
                with suppress(DataError):
                    found[folder.name] = names(folder)
    return found


def read_model(folder: Path, *, pointless: bool = False) -> Model:
    """Read and check a model.

    Args:
        folder: Has its files.
        pointless: Whether it may be poses alone.

    Raises: DataError, one line, naming the file and the fault.
    """
    suffix, index_files = next(
        reader
        for reader in (*_READERS, _READERS[0])
        if any((folder / f"{file}{reader[0]}").is_file() for file in MODEL_FILES)
    )
    missing = [f"{n}{suffix}" for n in MODEL_FILES if not (folder / f"{n}{suffix}").is_file()]
    if missing:
        raise DataError(f"{folder / missing[0]}: missing; a model has cameras, images and points3D")
    alone = [n for n in RIG_FILES if (folder / f"{n}{suffix}").is_file()]
    if len(alone) == 1:
        raise DataError(
            f"{folder}: has {alone[0]}{suffix} without its partner; "
            "rigs and frames come together or not at all"
        )
    index = index_files(folder)
    check_references(folder, suffix, index)
    reconstruction = pycolmap.Reconstruction()
    try:
        if suffix == colmap_binary.SUFFIX:
            reconstruction.read_binary(folder)
        else:
            reconstruction.read_text(folder)
    except (ValueError, IndexError, RuntimeError, MemoryError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise DataError(f"{folder}: COLMAP cannot read this model ({said})") from None
    names = dict(zip(index.image_ids, index.image_names, strict=True))
    for number, image in reconstruction.images.items():
        image.name = names[number]  # COLMAP's reader of text ends a name at its first blank
    images = tuple(
        sorted(
            (image for image in reconstruction.images.values() if image.has_pose),
            key=lambda image: image.name,
        )
    )
    model = Model(
        folder=folder,
        reconstruction=reconstruction,
        index=index,
        images=images,
        sha256=_hash(folder, suffix),
    )
    _check_numbers(model, suffix, pointless)
    return model


def pose_matrix(image: pycolmap.Image) -> Float64[np.ndarray, "3 4"]:
    """World to camera of an image; COLMAP keeps quaternions as read, here they get length 1."""
    pose = image.cam_from_world()
    quaternion = pose.rotation.quat / np.linalg.norm(pose.rotation.quat)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion), pose.translation).matrix()


def _check_numbers(model: Model, suffix: str, pointless: bool) -> None:
    """Poses, used cameras and points must be finite, focal lengths positive."""
    if not model.images:
        raise DataError(
            f"{model.folder / f'images{suffix}'}: none of {len(model.index.image_ids)} images has "
            "a pose; run the mapper first"
        )
    if not pointless and not len(model.index.point_ids):
        raise DataError(
            f"{model.folder / f'points3D{suffix}'}: has no points, which methods start from; "
            "`--points triangulated` makes some from the training photos (in a protocol: "
            'points = "triangulated")'
        )
    for image in model.images:
        pose = image.cam_from_world()
        length = float(np.linalg.norm(pose.rotation.quat))
        if not (np.isfinite(pose.translation).all() and abs(length - 1) < _UNIT):
            raise DataError(
                f"{model.folder}: the pose of image {image.name!r} has a rotation quaternion of "
                f"length {length:.6g} and translation {pose.translation.tolist()}, expected "
                "length 1 and finite numbers; run the mapper again"
            )
        camera = model.reconstruction.camera(image.camera_id)
        if not has_focal_length(camera):
            raise DataError(
                f"{model.folder / f'cameras{suffix}'}: camera {image.camera_id} has parameters "
                f"{camera.params.tolist()}, expected finite ones and positive focal lengths"
            )
    finite = np.isfinite(model.index.positions).all(axis=1)
    if not finite.all():
        number = model.index.point_ids[finite.argmin()]
        raise DataError(f"{model.folder / f'points3D{suffix}'}: point {number} is not finite")


def _hash(folder: Path, suffix: str) -> str:
    digest = hashlib.sha256()
    for name in (*MODEL_FILES, *RIG_FILES):
        path = folder / f"{name}{suffix}"
        if path.is_file():
            digest.update(f"{path.name} {path.stat().st_size}\n".encode())
            digest.update(read_bytes(path))
    return digest.hexdigest()
