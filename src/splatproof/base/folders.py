"""Folders that exist whole or not at all. (Files: splatproof.base.files.)"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SUFFIX = ".partial"
"""End of temporary names; what carries it after a kill is rubbish."""


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
