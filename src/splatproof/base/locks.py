"""Lock files: one process at a time; the kernel frees them when the process ends, however it ends."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from splatproof.base.errors import MissingError, UsageError


@contextmanager
def locked(
    path: Path, *, busy: str = "", elsewhere: str = "choose another folder"
) -> Iterator[None]:
    """Hold the lock file `path` while the block runs.

    Args:
        path: The lock file, made where it is missing, with its folders; its content is left alone.
        busy: What a user is told where another process holds the lock; empty: wait for it.
        elsewhere: What a user can do where the file cannot be made.

    Raises: UsageError saying `busy`; MissingError where the file cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a")
    except OSError as error:
        said = f"{path.parent}: cannot write here ({error.strerror}); {elsewhere}"
        raise MissingError(said) from None
    with file:
        lock(file, busy=busy)
        yield


def lock(file: IO[Any], *, busy: str = "") -> None:
    """Lock an open file until it is closed.

    Args:
        file: Any open file; its content is left alone.
        busy: What a user is told where another process holds the lock; empty: wait for it.

    Raises: UsageError saying `busy`.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy else 0))
    except BlockingIOError:
        raise UsageError(busy) from None


@contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Hold a lock on a folder while the block runs, waiting for it; nothing is written.

    Args:
        path: A folder that can be read.
    """
    held = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        os.close(held)
