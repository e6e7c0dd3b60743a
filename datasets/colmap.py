"""Opens COLMAP scene folders: a model in sparse/0 or sparse, photos beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.inside import inside
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.colmap_model import (
    Model,
    find_model,
    other_models,
    pose_matrix,
    read_model,
)
from splatproof.datasets.layout import (
    FULL_SIZE_FOLDERS,
    MISSING,
    Layout,
    PosedPhoto,
    copy_factor,
)
from splatproof.datasets.moving_masks import FOLDER, moving_masks
from splatproof.datasets.photos import list_photos
from splatproof.datasets.scene_file import SceneFile, read_scene_file
from splatproof.datasets.sparse_points import read_points
from splatproof.datasets.sweep_files import list_sweeps
from splatproof.datasets.view_times import Moment, read_moments, sky_path
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

MASKS = "masks"
"""Folder of COLMAP's masks beside the photos: a pixel that is black there is not used."""
NOT_REGISTERED = "structure from motion did not register it"


def open_colmap(folder: Path, protocol: Protocol) -> Scene:
    """Read a COLMAP scene; photos are only looked at (size), not decoded.

    Images whose photo is not there are left out with that reason, unless the protocol is strict.
    Masks are found as COLMAP finds them: masks/NAME.png for the photo NAME, else that name with .png
    for its suffix; photos without one are whole. Copies N times smaller have theirs in masks_N.

    Args:
        folder: Has the model, the photos, and masks where there are any.
        protocol: Image folder, sizes, undistortion and split.

    Raises: DataError naming the file and the fault; UsageError for a protocol that does not fit.
    """
    model = read_model(find_model(folder), pointless=protocol.points != "scene")
    photos = photo_folder(folder, protocol)
    about = read_scene_file(folder)
    names = [image.name for image in model.images]
    moments = read_moments(folder, names)
    posed = posed_photos(model, photos)
    missing = {} if protocol.strict else _missing(model, posed)
    there = tuple(image for image in model.images if image.name not in missing)
    layout = Layout(
        adapter="colmap",
        photos=_with_moments(folder, [p for p in posed if p.name not in missing], moments),
        points=read_points(replace(model, images=there)),
        sweeps=list_sweeps(folder) if moments else (),
        up=about.up,
        up_source="scene.toml",
        units=about.units,
        left_out=_left_out(photos, model, missing, about),
        facts=about.facts | {"model_sha256": model.sha256, "image_folder": photos.name},
    )
    return open_layout(folder, layout, protocol)


def photo_folder(scene: Path, protocol: Protocol) -> Path:
    """The protocol's image folder; "photos" and "images" are two names of the full-size one.

    Args:
        scene: Folder that has the folder of photos.
        protocol: Its `images` names the folder.
    Raises: DataError if it is not there.
    """
    wanted = [protocol.images]
    if protocol.images in FULL_SIZE_FOLDERS:
        wanted += [name for name in FULL_SIZE_FOLDERS if name != protocol.images]
    for name in wanted:
        if (scene / name).is_dir():
            return scene / name
    raise DataError(
        f"{scene}: no photos; looked for the folder {' or '.join(wanted)} "
        f"(protocol {protocol.name})"
    )


def posed_photos(model: Model, photos: Path) -> list[PosedPhoto]:
    """The registered images of a model, their files in the folder `photos`.

    Args:
        model: The checked model.
        photos: Folder of the photos that the model's images name; copies N times smaller lie in
            a folder whose name ends in _N.
    Raises: DataError for a name that leads out of that folder, see `inside`.
    """
    several = len({image.camera_id for image in model.images}) > 1
    posed = []
    for image in model.images:
        world_to_camera = pose_matrix(image)
        rotation = world_to_camera[:, :3].T
        posed.append(
            PosedPhoto(
                name=image.name,
                path=inside(photos, image.name, f"{model.folder}: an image's name"),
                camera=model.reconstruction.camera(image.camera_id),
                camera_to_world=np.concatenate(
                    [rotation, -rotation @ world_to_camera[:, 3:]], axis=1
                ),
                factor=copy_factor(photos.name),
                sensor=f"camera {image.camera_id}" if several else "",
            )
        )
    return posed


def _with_moments(
    folder: Path, photos: list[PosedPhoto], moments: Mapping[str, Moment]
) -> list[PosedPhoto]:
    """The photos with time, camera, and masks where the folder has them."""
    found = []
    for photo in photos:
        sky = sky_path(folder, photo.name)
        moment = moments.get(photo.name)
        found.append(
            replace(
                photo,
                valid=_mask(folder, photo),
                sky=sky if sky.is_file() else None,
                moving=moving_masks(folder / FOLDER, str(Path(photo.name).with_suffix(".png"))),
                time=moment.time if moment else None,
                sensor=moment.sensor if moment and moment.sensor else photo.sensor,
            )
        )
    return found


def _mask(folder: Path, photo: PosedPhoto) -> Path | None:
    """The photo's mask, None where it has none. Raises: DataError where only its larger original has."""
    names = (f"{photo.name}.png", str(Path(photo.name).with_suffix(".png")))
    whole = _first_file([folder / MASKS / name for name in names])
    if photo.factor == 1:
        return whole
    copies = folder / f"{MASKS}_{photo.factor}"
    mask = _first_file([copies / name for name in names])
    if whole and not mask:
        raise DataError(
            f"{copies}: has no mask of {photo.name!r}, but {whole} is there; make the masks smaller as "
            f"the photos, or remove {folder / MASKS} to go without"
        )
    return mask


def _first_file(paths: Sequence[Path]) -> Path | None:
    return next((path for path in paths if path.is_file()), None)


def _missing(model: Model, posed: Sequence[PosedPhoto]) -> dict[str, str]:
    """Name of each photo that is not there: why it is left out. Raises: DataError if none is."""
    missing = {p.name: f"{MISSING}: {p.path}" for p in posed if not p.path.is_file()}
    if len(missing) == len(posed):
        raise DataError(
            f"{model.folder}: not one photo of its {len(posed)} images is there, expected "
            f"{posed[0].path} and others; put them there"
        )
    return missing


def _left_out(
    photos: Path, model: Model, missing: dict[str, str], about: SceneFile
) -> tuple[tuple[str, str], ...]:
    """Every photo that is no view, and every one that the scene file knows to be missing."""
    names = {image.name for image in model.images}
    others = (set(list_photos(photos)) | set(about.left_out)) - names
    elsewhere = _elsewhere(model) if others - set(about.left_out) else {}
    reasons = {
        name: about.left_out.get(name, elsewhere.get(name, NOT_REGISTERED)) for name in others
    } | missing
    return tuple(sorted(reasons.items()))


def _elsewhere(model: Model) -> dict[str, str]:
    """Name of each photo of the models beside this one: which has it."""
    place = model.folder.parent.name
    return {
        name: f"is in {place}/{number}, another model, of {len(names)} photos; {place}/{model.folder.name} is used, of "
        f"{len(model.images)}"
        for number, names in other_models(model.folder).items()
        for name in names
    }
