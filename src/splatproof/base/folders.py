"""Folders that exist whole or not at all. (Files: splatproof.base.files.)"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatproof.base.errors import MissingError

SUFFIX = ".partial"
"""End of temporary names; what carries it after a kill is rubbish."""
RESERVE = 64 * 2**20
"""Bytes of a disk that are left free."""


def check_disk(folder: Path, needed: int, remedy: str) -> None:
    """Refuse work that would fill a disk, before native code does it that ends the process there.

    Args:
        folder: One on that disk.
        needed: Bytes that are to be written.
        remedy: What to do about it.
    Raises: MissingError where fewer than these and RESERVE are free.
    """
    free = shutil.disk_usage(folder).free
    if needed + RESERVE > free:
        raise MissingError(
            f"{folder}: {needed / 2**20:.0f} MB are to come and {free / 2**20:.0f} MB are free, of which "
            f"{RESERVE >> 20} stay free; {remedy}"
        )


@contextmanager
def working_folder(path: Path) -> Iterator[Path]:
    """An empty folder beside `path` that is gone when the block ends, however it ends.

    What a killed process left there goes first.
    """
    temporary = path.with_name(path.name + SUFFIX)
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """An empty folder beside `path` that replaces `path` when the block ends without an error.

    A folder cannot be exchanged in one step, so the old one goes first: a kill between the two
    leaves neither, never a mixture.
    """
    with working_folder(path) as temporary:
        yield temporary
        shutil.rmtree(path, ignore_errors=True)
        temporary.rename(path)
