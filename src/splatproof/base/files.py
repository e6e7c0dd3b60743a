"""The door for files: regular ones alone, read within bounds, written whole or not at all."""

import errno
import glob
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.base.memory import check_room

PARTIAL = ".partial"
"""End of the names of files that are being written."""
CHUNK = 2**20
"""Bytes that are read at a time from something that may be large."""
ROOM = 200
"""Bytes of a name to which an ending is added."""
KINDS = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
)  # fmt: skip
"""What a name can be instead of a file."""


def size_of(path: Path, fault: type[SplatproofError] = DataError) -> int:
    """Bytes of a regular file, or of the one that a link leads to; to be asked before it is opened.

    A pipe would be waited for without end, and a device has none either.

    Args:
        path: The file.
        fault: Type of the error that is raised.
    Raises: `fault` naming the path where it is missing, cannot be reached or is no regular file.
    """
    try:
        found = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        raise fault(f"{path}: no such file") from None
    except OSError as error:
        raise fault(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # a NUL or a lone surrogate in the name
        raise fault(f"{str(path)!r}: no such file: not a name that a file can have") from None
    if not stat.S_ISREG(found.st_mode):
        raise fault(f"{path}: is {_kind(found.st_mode)}, expected a file")
    return found.st_size


def _kind(mode: int) -> str:
    return next((name for test, name in KINDS if test(mode)), "no file")


def read_bytes(path: Path, fault: type[SplatproofError] = DataError) -> bytes:
    """The bytes of a regular file that fits into this machine's memory.

    Args:
        path: The file.
        fault: Type of the error that is raised.
    Raises: `fault` naming the path and what is wrong; MissingError where memory is short.
    """
    size = size_of(path, fault)
    check_room(path, size)
    try:
        return path.read_bytes()
    except OSError as error:
        raise fault(f"{path}: cannot be read: {error.strerror}") from None


def read_text(path: Path, fault: type[SplatproofError] = DataError) -> str:
    """The text of a regular file in UTF-8 that fits into this machine's memory.

    Args:
        path: The file.
        fault: Type of the error that is raised.
    Raises: As `read_bytes`, and `fault` where it is not text.
    """
    try:
        return read_bytes(path, fault).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise fault(f"{path}: not UTF-8 text (byte {error.start})") from None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Name for a new file beside `path` that takes its place when the block ends without an error.

    Folders above are made. After an error nothing is left; after a kill, at most a file whose name
    ends in ".partial".

    Args:
        path: Name of the finished file; a regular one that is there is replaced.
    Raises: UsageError where there is anything else by that name, such as a folder or a device, which
        a rename would replace; OSError where the file cannot be written.
    """
    check_target(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{_short(path.name)}.{os.getpid()}{PARTIAL}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _short(name: str) -> str:
    """A name with room for an ending: no part of a path may have more than 255 bytes."""
    return name if len(os.fsencode(name)) <= ROOM else hashlib.sha256(os.fsencode(name)).hexdigest()


def check_target(path: Path) -> None:
    """Refuse a name under which no file can be written; to be asked before long work too.

    Raises: UsageError where there is anything but a regular file, or a file where a folder above
        should be, or where no system takes such a name.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return
    except NotADirectoryError:
        above = next(p for p in path.parents if p.exists() and not p.is_dir())
        raise UsageError(f"{path}: {above} is a file, expected a folder; choose another") from None
    except ValueError:
        raise UsageError(
            f"{str(path)!r}: not a name that a file can have; choose another"
        ) from None
    except OSError as error:
        if error.errno not in (errno.ENAMETOOLONG, errno.ELOOP):
            raise
        raise UsageError(f"{path}: {error.strerror}; choose another name") from None
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path}: is {_kind(mode)}, expected a file to write; choose another name")


def remove_stale(path: Path) -> None:
    """Remove what writers of one file left beside it that were killed on this machine.

    To be asked where a user names the file: nothing else looks there again. What a process is still
    writing stays.

    Args:
        path: Name of the finished file.
    """
    for partial in path.parent.glob(f"{glob.escape(_short(path.name))}.*{PARTIAL}"):
        writer = partial.name.removesuffix(PARTIAL).rpartition(".")[2]
        if writer.isdecimal() and not _is_alive(int(writer)):
            partial.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    """Whether there is a process of that number, whoever's it is."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def remove_partial_files(folder: Path) -> None:
    """Remove what killed writers left in a folder and below; nobody else may be writing there.

    Args:
        folder: Folder of a work that is continued.
    """
    for path in folder.rglob(f"*{PARTIAL}"):
        path.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file that is there whole or not at all.

    Names of files that are not UTF-8 have lone surrogates in Python's text. They are written as the
    escapes that JSON has for them, and come back from it.

    Args:
        path: Name of the file; its folder is made, and a file that is there is replaced.
        text: What it is to hold; line ends stay as they are.
    """
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


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
        return json.loads(read_bytes(path), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not JSON ({error})") from None


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def sha256(path: Path) -> str:
    """Hash of a file's bytes, in hexadecimal. Raises: DataError if it is no regular file."""
    size_of(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def tree_sha256(folder: Path) -> str:
    """Hash of the names and bytes of all files below a folder, in hexadecimal."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    lines = [f"{path.relative_to(folder).as_posix()} {sha256(path)}\n" for path in files]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
