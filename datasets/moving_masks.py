"""Masks of what moves in a drive, as files: a folder a kind, a mask image a photo."""

from collections.abc import Mapping
from pathlib import Path

from splatproof.base.errors import DataError

KINDS = ("vehicles", "people")
"""What moves; the names of the masks of a view."""
FOLDER = "moving"
"""Folder of the masks in a scene folder of ours: moving/<kind>/<stem>.png."""
OURS = {kind: kind for kind in KINDS}


def moving_masks(root: Path, name: str, folders: Mapping[str, str] = OURS) -> dict[str, Path]:
    """Kind of what moves to the photo's mask file; empty where the set has no folder of masks.

    Args:
        root: The folder of masks.
        name: Name of the photo's mask file inside each kind's folder.
        folders: Kind of what moves to the name of its folder below `root`.
    Raises: DataError naming a file that is missing while the folder is there.
    """
    if not root.is_dir():
        return {}
    files = {kind: root / folder / name for kind, folder in folders.items()}
    for path in files.values():
        if not path.is_file():
            raise DataError(
                f"{path}: mask of what moves is missing; export it again, or remove {root} to go "
                "without"
            )
    return files
