"""Where made and downloaded things are kept, and a lock so that two processes make them once."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatproof.base.errors import MissingError


def cache_folder() -> Path:
    """SPLATPROOF_CACHE, else splatproof below XDG_CACHE_HOME, else ~/.cache/splatproof."""
    named = os.environ.get("SPLATPROOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    # the XDG specification: a relative path is to be ignored
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "splatproof"


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file `path` (made where missing) while the block runs; others wait.

    The system gives the lock back when the process ends, however it ends.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = path.open("a")
    except OSError as error:
        raise MissingError(
            f"{path.parent}: cannot write here ({error.strerror}); set SPLATPROOF_CACHE to a "
            "folder that can be written"
        ) from None
    with handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
