"""How a command ends: every fault that a user or a machine can cause is one line and an exit code."""

import errno
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from splatproof.base.errors import MissingError, SplatproofError, UsageError

_ROOM = "make room or choose another folder; the same command continues where it stopped"
_RIGHTS = "choose another folder, or change who may use it"
OF_THE_MACHINE = {
    errno.ENOSPC: _ROOM, errno.EDQUOT: _ROOM, errno.EFBIG: _ROOM,
    errno.EACCES: _RIGHTS, errno.EPERM: _RIGHTS, errno.EROFS: _RIGHTS,
}  # fmt: skip
"""What a disk can have against a command, and what to do about it."""
OF_THE_NAME = (
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP,
    errno.EINVAL, errno.ENOTEMPTY,
)  # fmt: skip
"""What is wrong with a path that a user gave, or that was taken away meanwhile."""
_WHERE = "SPLATPROOF_DEBUG=1 shows where"
NO_MEMORY = "can't allocate memory"
"""Words of torch's error for it, which has no type of its own."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came: clean up as after ctrl-C."""


@contextmanager
def sigterm_told() -> Iterator[None]:
    """SIGTERM raises Terminated inside the block; only the main thread may ask for that."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def told(action: Callable[[], int]) -> int:
    """The exit code of a command; what a user or a machine can cause becomes one line on stderr.

    With SPLATPROOF_DEBUG set the traceback is printed too. What is our own fault is raised.

    Args:
        action: Runs the command and gives its exit code.
    """
    try:
        return action()
    except SplatproofError as error:
        if os.environ.get("SPLATPROOF_DEBUG"):
            traceback.print_exc()
        print(f"bench: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        if os.environ.get("SPLATPROOF_DEBUG"):
            traceback.print_exc()
        print(f"bench: {_of_the_system(error)}", file=sys.stderr)
        return (UsageError if error.errno in OF_THE_NAME else MissingError).exit_code
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and NO_MEMORY not in str(error):
            raise
        if os.environ.get("SPLATPROOF_DEBUG"):
            traceback.print_exc()
        print(f"bench: out of memory; take fewer or smaller images; {_WHERE}", file=sys.stderr)
        return MissingError.exit_code
    except KeyboardInterrupt as ended:
        told = isinstance(ended, Terminated)
        how = "terminated" if told else "interrupted"
        print(f"bench: {how}; the same command continues where it stopped", file=sys.stderr)
        return 128 + (signal.SIGTERM if told else signal.SIGINT)
    except SystemExit as exit_:  # tyro: 0 after --help, 2 after a usage error it has printed
        return exit_.code if isinstance(exit_.code, int) else 2


def _of_the_system(error: OSError) -> str:
    """What the system has against a command, in one line."""
    where = f"{error.filename2 or error.filename}: " if error.filename else ""
    said = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
    advice = "check the path, or choose another" if error.errno in OF_THE_NAME else _WHERE
    return f"{where}{said or type(error).__name__}; {OF_THE_MACHINE.get(error.errno or 0, advice)}"
