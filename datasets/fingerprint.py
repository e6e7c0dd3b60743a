"""What the files of a scene hold, so that a result can say what it was made of."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.reference.types.scene import Scene

Known = dict[str, tuple[int, int, str]]
"""Absolute path -> (bytes, time of change in ns, sha256) of files that were read before."""


def files_sha256(
    scene: Scene,
    known: Known,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> str:
    """Hash of the names and contents of the scene's `sources`; "" where it has none.

    It depends neither on where the folder lies nor on the files' times: a copy has the same.

    Args:
        scene: The scene; its `sources` are the files.
        known: A file whose size and time of change are those in here is not read again; what is
            read is added.
        report: Told (files looked at, files in all).
    Raises: DataError naming a file that cannot be read.
    """
    if scene.root is None or not scene.sources:
        return ""
    digest = hashlib.sha256()
    for index, path in enumerate(scene.sources):
        name = Path(os.path.relpath(path, scene.root)).as_posix()
        digest.update(f"{name} {_sha256(path, known)}\n".encode())
        report(index + 1, len(scene.sources))
    return digest.hexdigest()


def _sha256(path: Path, known: Known) -> str:
    key = str(path.absolute())
    try:
        stat = path.stat()
        mark = (stat.st_size, stat.st_mtime_ns)
        if key not in known or known[key][:2] != mark:
            known[key] = (*mark, sha256(path))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    return known[key][2]
