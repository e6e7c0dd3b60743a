"""How a command ends: every fault that a user or a machine can cause is one line and an exit code."""

import errno
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from splatproof.base.errors import MissingError, SplatproofError, UsageError
from splatproof.base.signals import ENDING

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
AGAIN = 0.01
"""Seconds after which a signal is raised again that nothing could hear."""
_WHERE = "SPLATPROOF_DEBUG=1 shows where"
NO_MEMORY = "can't allocate memory"
"""Words of torch's error for it, which has no type of its own."""


def ended(action: Callable[[], int]) -> int:
    """The exit code of a command; what a user or a machine can cause becomes one line on stderr.

    SIGTERM cleans up as ctrl-C does; in the main thread, where alone Python hears signals. An import
    that is broken off may end in an error of its own, such as native code's "initialization failed":
    whatever is raised after a signal is the signal's.

    With SPLATPROOF_DEBUG set the traceback is printed too. What is our own fault is raised.

    Args:
        action: Runs the command and gives its exit code.
    """
    with _noted() as came:
        try:
            return _told(action, came)
        except BaseException as error:
            if not (came or isinstance(error, KeyboardInterrupt)):
                raise
            _show()
    number = came[0] if came else signal.SIGINT
    how = "terminated" if number == signal.SIGTERM else "interrupted"
    print(f"bench: {how}; the same command continues where it stopped", file=sys.stderr)
    return 128 + number


@contextmanager
def _noted() -> Iterator[list[int]]:
    """Signals that ask for the end raise KeyboardInterrupt inside the block; those that came."""
    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    def again(lost: Any) -> None:
        # it came inside a destructor or a callback, where Python drops what is raised
        if came and lost.exc_type is KeyboardInterrupt:
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        else:
            hook(lost)

    def alarm(number: int, _: FrameType | None) -> None:
        raise KeyboardInterrupt

    main = threading.current_thread() is threading.main_thread()
    hook = sys.unraisablehook
    before = {number: signal.getsignal(number) for number in ENDING} if main else {}
    if before.get(signal.SIGINT) is signal.SIG_IGN:  # as a shell sets it for work in the background
        del before[signal.SIGINT]
    for number in before:
        signal.signal(number, note)
    if main:
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, alarm) or signal.SIG_DFL
        sys.unraisablehook = again
    try:
        yield came
    finally:
        if main:
            signal.setitimer(signal.ITIMER_REAL, 0)
            sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _told(action: Callable[[], int], came: list[int]) -> int:
    """The exit code, with errors told that no signal brought."""
    try:
        return action()
    except SystemExit as exit_:  # tyro: 0 after --help, 2 after a usage error it has printed
        if came:
            raise
        return exit_.code if isinstance(exit_.code, int) else 2
    except Exception as error:
        if came or isinstance(error, BrokenPipeError):
            raise
        said, code = _of(error)
        _show()
        print(f"bench: {said}", file=sys.stderr)
        return code


def _show() -> None:
    """The traceback of what is being handled, for those who ask for it."""
    if os.environ.get("SPLATPROOF_DEBUG"):
        traceback.print_exc()


def _of(error: Exception) -> tuple[str, int]:
    """What to say of an error, and its exit code. Raises: the error, where it is our own fault."""
    if isinstance(error, SplatproofError):
        return " ".join(str(error).split()), error.exit_code
    if isinstance(error, OSError):
        fault = UsageError if error.errno in OF_THE_NAME else MissingError
        return _of_the_system(error), fault.exit_code
    if isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and NO_MEMORY in str(error)
    ):
        return f"out of memory; take fewer or smaller images; {_WHERE}", MissingError.exit_code
    raise error


def _of_the_system(error: OSError) -> str:
    """What the system has against a command, in one line."""
    where = f"{error.filename2 or error.filename}: " if error.filename else ""
    said = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
    advice = "check the path, or choose another" if error.errno in OF_THE_NAME else _WHERE
    return f"{where}{said or type(error).__name__}; {OF_THE_MACHINE.get(error.errno or 0, advice)}"
