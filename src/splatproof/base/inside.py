"""Names that come from files: none leads out of the folder that it belongs to, unless it is asked."""

import os
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from splatproof.base.errors import DataError, SplatproofError

LONGEST = 255
"""Bytes of a name that file systems take."""
_allowed: ContextVar[bool] = ContextVar("outside_allowed", default=False)


def outside_is_allowed() -> bool:
    """Whether scene files may name files outside their scene's folder."""
    return _allowed.get()


@contextmanager
def allowing_outside(allowed: bool) -> Iterator[None]:
    """Inside the block, in this thread and in workers that it starts, `allowed` holds.

    Args:
        allowed: True: scene files may name files anywhere; False: in their scene's folder alone.
    """
    token = _allowed.set(allowed)
    try:
        yield
    finally:
        _allowed.reset(token)


def checked_name(
    name: str, where: str, fault: type[SplatproofError] = DataError, *, nested: bool = True
) -> str:
    """A name that becomes a file or folder below another one, as it is.

    Args:
        name: Names separated by "/".
        where: The file and place that give it, for errors.
        fault: Type of the error that is raised.
        nested: Whether there may be several of them.
    Raises: `fault` for a name that is empty, absolute, has "." or ".." in it, control letters,
        or more bytes than a file system takes.
    """
    parts = name.split("/")
    plain = _plain(name) and all(part not in ("", ".", "..") for part in parts)
    if not plain or any(len(part.encode()) > LONGEST for part in parts):
        raise fault(f"{where}: {_shown(name)} cannot be a name: expected letters without '..', "
                    f"none of them a control letter, at most {LONGEST} bytes each")  # fmt: skip
    if not nested and len(parts) > 1:
        raise fault(f"{where}: {_shown(name)} has a '/'; expected one name")
    return name


def inside(root: Path, name: str, where: str, within: Path | None = None) -> Path:
    """The path of a file that a scene's file names, which must lie in the scene's folder.

    A link counts as what it leads to; where `root` itself is reached by a link, what lies there is
    inside.

    Args:
        root: Folder that the name is relative to.
        name: The name.
        where: The file and place that give it, for errors.
        within: Folder that must hold it, where that is another than `root`.
    Returns: root / name. The file may be missing.
    Raises: DataError for a name that no file can have, or one that leads elsewhere while
        `outside_is_allowed` is false.
    """
    if not name or name.endswith("/") or not _plain(name):
        raise DataError(f"{where}: {_shown(name)} is no name of a file")
    path = root / name
    holder = (root if within is None else within).resolve()
    if not outside_is_allowed() and not _place(path, name, where).is_relative_to(holder):
        raise DataError(
            f"{where}: {_shown(name)} leads out of {holder}; put the file there, or trust the scene's "
            "files with --allow-outside"
        )
    if os.path.normpath(path) == os.path.normpath(root):
        raise DataError(f"{where}: {_shown(name)} is the folder itself, expected a file in it")
    return path


def check_link(path: Path, folder: Path) -> None:
    """Refuse a scene's file that is a link to one elsewhere, whoever listed or named it.

    A folder of a scene may be a link: what lies in it is in the scene.

    Args:
        path: A file that is in the scene's folder, or stands beside it, by its name.
        folder: The scene's folder.
    Raises: DataError where it leads out of the scene's folder and its own, while
        `outside_is_allowed` is false.
    """
    if outside_is_allowed() or not path.is_symlink():
        return
    place = _place(path, path.name, str(path.parent))
    if not any(place.is_relative_to(home.resolve()) for home in (folder, path.parent)):
        raise DataError(
            f"{path}: is a link that leads out of {folder}; put the file there, or trust the scene's "
            "files with --allow-outside"
        )


def _plain(name: str) -> bool:
    """Whether no letter is a control letter or half of one (a lone surrogate)."""
    return not any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name)


def _place(path: Path, name: str, where: str) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # links in a circle, names too long
        raise DataError(f"{where}: {_shown(name)} cannot be followed ({error})") from None


def _shown(name: str) -> str:
    """A name in an error: its letters that do not print as escapes, and not all of a long one."""
    return repr(name if len(name) <= 80 else f"{name[:77]}...")
