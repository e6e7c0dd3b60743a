"""A process that ends with another: the kernel kills it once a pipe of the other's is closed (Linux).

That is as soon as the other has died, however it died, while a thread that waits for it may itself have
to wait for native code or an import. A parent-death signal would not do: it comes when the thread ends
that started the process. Elsewhere than on Linux there is no such help.
"""

import contextlib
import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing.connection import Connection

OFFERED = "SPLATPROOF_FORK_SERVER_LEASH"
"""Variable in a fork server's environment: the end of the pipe that it shall hold, as a file."""


class Leash:
    """Sent to a worker before all else: taken up by being unpickled."""

    def __init__(self, end: Connection) -> None:
        """What is to be sent.

        Args:
            end: End of a pipe to read from, whose other end the sender alone holds.
        """
        self._end = end

    def __reduce__(self) -> tuple[Callable[[Connection], "Leash"], tuple[Connection]]:
        """How it is pickled."""
        return _taken, (self._end,)


_ends: list[Connection] = []
"""The ends that this process holds, so that they stay open."""


def _taken(end: Connection) -> Leash:
    """In the process that is to end: die with the pipe."""
    if hasattr(fcntl, "F_SETSIG"):
        with contextlib.suppress(OSError):
            fcntl.fcntl(end.fileno(), fcntl.F_SETOWN, os.getpid())
            fcntl.fcntl(end.fileno(), fcntl.F_SETSIG, signal.SIGKILL)
            flags = fcntl.fcntl(end.fileno(), fcntl.F_GETFL)
            fcntl.fcntl(end.fileno(), fcntl.F_SETFL, flags | os.O_ASYNC)
    if end.poll():  # closed already
        os._exit(1)
    _ends.append(end)
    return Leash(end)


@contextmanager
def offered() -> Iterator[None]:
    """A fork server that is started in the block may take a leash up, by `take_offered`.

    It is passed no open files but its own, so it is told where this process holds one.
    """
    os.environ[OFFERED] = f"/proc/{os.getpid()}/fd/{_pipe()[0]}"
    try:
        yield
    finally:
        os.environ.pop(OFFERED, None)


@cache
def _pipe() -> tuple[int, int]:
    """The pipe of this process's fork servers; open as long as it lives."""
    return os.pipe()


def take_offered() -> None:
    """In a fork server: end with the process that started it, also while modules are imported.

    By itself it looks after its pipe only when all modules are imported that it imports ahead.
    """
    end = os.environ.pop(OFFERED, None)
    if end is None or not hasattr(fcntl, "F_SETSIG"):
        return
    try:
        held = os.open(end, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:  # it has died already
        os._exit(1)
    except OSError:
        return  # a system that shows no process's files: then it ends when its imports are done
    _taken(Connection(held, writable=False))
