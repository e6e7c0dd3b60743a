"""Strips: up to five held-out views of a row, with the photo above and the error below."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from splatproof.reference.types.result import picture_name
from splatproof.reference.types.scene import View

Image = UInt8[np.ndarray, "_ _ 3"]
"""BGR."""
VIEWS = 5
"""Most views of a strip; several may show one moment."""
SHARE = 0.6
"""Side of the shown part of a view over the view's, where something moves in it."""
WIDTH = 190
"""Pixels that a tile is wide."""
BAR = 22
"""Pixels that a line of text is high."""
QUALITY = 82
KINDS = ("truth", "renders", "errors")
"""Folders of a case, from top to bottom."""


@dataclass(frozen=True, kw_only=True)
class Crop:
    """The part of a view that is shown."""

    view: str
    """Name of the view."""
    top: int
    left: int
    height: int
    width: int

    @property
    def part(self) -> tuple[slice, slice]:
        """The part as indices of an image."""
        return (
            slice(self.top, self.top + self.height),
            slice(self.left, self.left + self.width),
        )


def crops(views: Sequence[View]) -> list[Crop]:
    """What is shown of a scene's scored views, the same for all rows.

    Where it is known what moves: the views with most of it, each cut to SHARE of its sides around the
    middle of what moves; else whole views, evenly spread.

    Args:
        views: The scored views, sorted by name.
    """
    moving = [_moving(view) for view in views]
    sizes = [int(mask.sum()) for mask in moving]
    if any(sizes):
        most = sorted(range(len(views)), key=lambda i: -sizes[i])
        chosen = [i for i in most[:VIEWS] if sizes[i]]
    else:
        chosen = [round(i * (len(views) - 1) / max(1, VIEWS - 1)) for i in range(VIEWS)]
    return [_around(views[i], moving[i]) for i in sorted(set(chosen))]


def _moving(view: View) -> Bool[np.ndarray, "h w"]:
    masks = view.load_moving() if view.load_moving else {}
    found = np.zeros(view.size, dtype=bool)
    for mask in masks.values():
        found |= mask.numpy()
    return found


def _around(view: View, moving: Bool[np.ndarray, "h w"]) -> Crop:
    height, width = view.size
    if not moving.any():
        return Crop(view=view.name, top=0, left=0, height=height, width=width)
    own = (round(SHARE * height), round(SHARE * width))
    middle = np.argwhere(moving).mean(axis=0)
    top, left = (
        int(np.clip(round(at - size / 2), 0, whole - size))
        for at, size, whole in zip(middle, own, view.size, strict=True)
    )
    return Crop(view=view.name, top=top, left=left, height=own[0], width=own[1])


def strip(folder: Path, chosen: Sequence[Crop], title: str) -> Image:
    """A row's strip: names of views, then photos, renders and FLIP errors of the chosen parts.

    Args:
        folder: Folder of a case.
        chosen: What is shown.
        title: Line above everything.
    Raises: FileNotFoundError naming a picture that the case does not have.
    """
    columns = []
    for crop in chosen:
        tiles = [_tile(folder / kind / picture_name(crop.view), crop) for kind in KINDS]
        columns.append(np.vstack([line_of(crop.view.rpartition(".")[0], WIDTH), *tiles]))
    body = np.hstack([part for one in columns for part in (one, _gap(one))][:-1])
    return np.vstack([line_of(title, body.shape[1]), body])


def _tile(path: Path, crop: Crop) -> Image:
    picture = cv2.imread(str(path))
    if picture is None:
        raise FileNotFoundError(f"{path}: no such picture; run the case again")
    return tile_of(picture, crop)


def tile_of(picture: Image, crop: Crop, width: int = WIDTH) -> Image:
    """The shown part of a picture.

    Args:
        picture: A view's photo, or what a model made of the view.
        crop: What is shown of it.
        width: Pixels that it is wide.
    """
    size = (width, round(width * crop.height / crop.width))
    kind = cv2.INTER_AREA if crop.width > width else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture[crop.part], size, interpolation=kind))


def _gap(column: Image) -> Image:
    return np.full((column.shape[0], 4, 3), 255, dtype=np.uint8)


def line_of(text: str, width: int) -> Image:
    """Black text on white, `width` pixels wide."""
    bar = np.full((BAR, width, 3), 255, dtype=np.uint8)
    cv2.putText(bar, text, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return bar


def save_strips(
    folders: Mapping[str, Path], chosen: Sequence[Crop], images: Path
) -> dict[str, Path]:
    """A JPEG for each row.

    Args:
        folders: Folder of a case by the row's name, in the page's order.
        chosen: What is shown of each.
        images: Folder of the pictures.
    Returns: The pictures by row.
    """
    images.mkdir(parents=True, exist_ok=True)
    made = {}
    for row, folder in folders.items():
        path = images / f"{file_name(row)}.jpg"
        cv2.imwrite(str(path), strip(folder, chosen, row), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        made[row] = path
    return made


def file_name(row: str) -> str:
    """A row's name with nothing but letters, digits, "-", "_" and ".".

    >>> file_name("hdgs@n2~depth-oracle+noise")
    'hdgs_n2_depth-oracle_noise'
    """
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in row)
