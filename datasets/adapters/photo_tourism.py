"""Photo Tourism: a COLMAP model of undistorted photos in dense/, and NeRF-W's split in a .tsv."""

import csv
from dataclasses import replace
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_text
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.colmap import NOT_REGISTERED, photo_folder, posed_photos
from splatproof.datasets.colmap_model import find_model, read_model
from splatproof.datasets.layout import Layout, PosedPhoto
from splatproof.datasets.photos import list_photos
from splatproof.datasets.sparse_points import read_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

COLUMNS = ("filename", "id", "split")
NOT_LISTED = "the split of NeRF-W does not use it"


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / "dense" / "sparse").is_dir()


def open_photo_tourism(folder: Path, protocol: Protocol) -> Scene:
    """Read a scene; photos without an id in the split's table are left out, as in NeRF-W.

    Args:
        folder: The scene's folder, with dense and one .tsv.
        protocol: Folder of photos, image sizes; the split is the table's, unless it names the
            test views.
    Raises: DataError for a table that is missing, damaged, or lists a photo with an id that the
        model does not have.

    Source: Martin-Brualla et al. 2021 (NeRF in the Wild), split files of the project page;
        Jin et al. 2020 (Image Matching Challenge), data.
    """
    tables = sorted(folder.glob("*.tsv"))
    if len(tables) != 1:
        found = ", ".join(path.name for path in tables) or "none"
        raise DataError(
            f"{folder}: expected one .tsv with the split, found {found}; "
            "get it from https://nerf-w.github.io"
        )
    splits = read_split(tables[0])
    dense = folder / "dense"
    model = read_model(find_model(dense))
    names = {image.name for image in model.images}
    for name in splits:
        if name not in names:
            raise DataError(
                f"{tables[0]}: lists {name!r}, which the model {model.folder} does not have; "
                "take the model and the split of one scene"
            )
    model = replace(model, images=tuple(i for i in model.images if i.name in splits))
    photos = photo_folder(dense, protocol)
    others = set(list_photos(photos)) - set(splits)
    layout = Layout(
        adapter="photo-tourism",
        photos=[_with_split(photo, splits[photo.name]) for photo in posed_photos(model, photos)],
        description=[tables[0]],
        points=read_points(model),
        left_out=tuple(
            (name, NOT_LISTED if name in names else NOT_REGISTERED) for name in sorted(others)
        ),
        facts={"model_sha256": model.sha256, "image_folder": photos.name},
    )
    return open_layout(folder, layout, protocol)


def _with_split(photo: PosedPhoto, split: str) -> PosedPhoto:
    return replace(photo, split="train" if split == "train" else "test")


def read_split(path: Path) -> dict[str, str]:
    """ "train" or "test" of each photo that has an id. Raises: DataError naming file and line."""
    try:
        rows = list(csv.reader(read_text(path).splitlines(), delimiter="\t"))
    except csv.Error as error:
        raise DataError(f"{path}: not a table ({error})") from None
    header = [name.strip() for name in rows[0]] if rows else []
    if not set(COLUMNS) <= set(header):
        raise DataError(f"{path}: has the columns {header}, expected {', '.join(COLUMNS)}")
    name_at, id_at, split_at = (header.index(name) for name in COLUMNS)
    splits: dict[str, str] = {}
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise DataError(f"{path}: line {number} has {len(row)} fields, expected {len(header)}")
        if not row[id_at].strip():
            continue
        if row[split_at] not in ("train", "test"):
            raise DataError(
                f"{path}: line {number} has the split {row[split_at]!r}, expected train or test"
            )
        splits[row[name_at]] = row[split_at]
    if "train" not in splits.values():
        raise DataError(f"{path}: has no training photo; expected rows with the split train")
    return splits
