"""Files that are there whole or not at all, checksums, and JSON read with one-line errors."""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError

PARTIAL = ".partial"
"""End of the names of files that are being written."""
CHUNK = 2**20
"""Bytes that are read at a time from something that may be large."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Name for a new file beside `path` that takes its place when the block ends without an error.

    Folders above are made. After an error nothing is left; after a kill, at most a file whose name
    ends in ".partial".

    Args:
        path: Name of the finished file; one that is there is replaced.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}{PARTIAL}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def remove_partial_files(folder: Path) -> None:
    """Remove what killed writers left in a folder and below; nobody else may be writing there.

    Args:
        folder: Folder of a work that is continued.
    """
    for path in folder.rglob(f"*{PARTIAL}"):
        path.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file that is there whole or not at all.

    Args:
        path: Name of the file; its folder is made, and a file that is there is replaced.
        text: What it is to hold; line ends stay as they are.
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all.

    Args:
        path: Name of the file; its folder is made, and a file that is there is replaced.
        content: What it is to hold.
    """
    with whole_file(path) as partial:
        partial.write_bytes(content)


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises: DataError naming the file when it is missing, cannot be read or is not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not JSON ({error})") from None


def sha256(path: Path) -> str:
    """Hash of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
