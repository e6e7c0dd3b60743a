"""Ctrl-C and SIGTERM around what they must not break off, and signals that native code takes over."""

import ctypes
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)
"""Signals by which a user or a batch system ends a command."""
TAKEN = (
    signal.SIGINT, signal.SIGTERM, signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE,
    signal.SIGILL,
)  # fmt: skip
"""Signals that the logs of native packages like to handle themselves."""
SIGACTION_BYTES = 1024
"""More than any system's struct sigaction (152 with glibc on x86-64), which is only copied."""


@contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait until the block is over, here and in processes that are started in it.

    They are blocked in this thread, which a new process inherits: one that is still importing
    cannot die of ctrl-C with a traceback, and lets them come when it is ready
    (splatproof.base.processes.serve_parent). Another thread may still be given the signal, and
    Python then calls its handler here; so the main thread also notes what comes and raises it at the
    end of the block.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    main = threading.current_thread() is threading.main_thread()
    handlers = {n: signal.getsignal(n) for n in ENDING} if main else {}
    handlers = {n: handler for n, handler in handlers.items() if callable(handler)}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    try:
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        for number in handlers:
            signal.signal(number, note)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # what waited is noted now
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextmanager
def kept() -> Iterator[None]:
    """Signals do after the block what they did before it, whatever native code asked for inside.

    Python does not know of handlers that native code installs, so they are copied by the C library,
    which also works in any thread.
    """
    library = ctypes.CDLL(None)
    before = {number: ctypes.create_string_buffer(SIGACTION_BYTES) for number in TAKEN}
    for number, action in before.items():
        library.sigaction(int(number), None, action)
    try:
        yield
    finally:
        for number, action in before.items():
            library.sigaction(int(number), action, None)
