"""Pictures of several rows in lines: the photos above, then what each row made of the same views."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from strips import QUALITY, Image, line_of

MOST = 5
"""Views of such a picture."""


def draw_lines(path: Path, scene: Path, lines: Sequence[str]) -> None:
    """Write a picture, where the runs have all of it: photos, then each line's images of the same views.

    Args:
        path: JPEG that is written.
        scene: Folder of a scene in the runs of a suite.
        lines: Folders below it, each with an image a view; the photos lie beside the first.
    """
    folders = [scene / line for line in lines]
    if not all(folder.is_dir() for folder in folders):
        return
    views = sorted(image.name for image in folders[0].iterdir())[:MOST]
    parts = []
    for title, folder in [
        ("photos", folders[0].parent / "truth"),
        *zip(lines, folders, strict=True),
    ]:
        images = np.hstack([_read(folder / view) for view in views])
        parts += [line_of(_title(title), images.shape[1]), images]
    cv2.imwrite(str(path), np.vstack(parts), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def _title(line: str) -> str:
    """What a line is called: its row, its protocol and whether it shows errors; other words as they are.

    >>> _title("second/pvg/street/seed0/errors")
    'pvg, street, FLIP error'
    """
    parts = line.split("/")
    if len(parts) == 1:
        return line
    row, protocol, _, kind = parts[-4:]
    return ", ".join([row, protocol, *(["FLIP error"] if kind == "errors" else [])])


def _read(path: Path) -> Image:
    image = cv2.imread(str(path))
    assert image is not None, path
    return np.asarray(image, dtype=np.uint8)
