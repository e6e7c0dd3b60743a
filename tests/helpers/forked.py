"""A process that begins as a copy of this one: what is imported here need not be imported again."""

import os
import signal
import time
import traceback
import warnings
from collections.abc import Callable


def forked(work: Callable[[], object]) -> int:
    """Start a process that does some work and ends; what it prints is not captured.

    Args:
        work: What it does. It must not use what other threads of this process may be at work on.
    Returns: Its process id, for `ended`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12: threads are not copied
        pid = os.fork()
    if pid:
        return pid
    try:
        work()
    except BaseException:  # noqa: BLE001 (nothing may come back into the copy of pytest)
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def ended(pid: int, seconds: float = 180.0) -> int:
    """Wait for a process; its exit code, or -N where signal N ended it.

    Args:
        pid: As `forked` returned it.
        seconds: How long at most: then it is killed, and the test has failed.
    """
    last = time.monotonic() + seconds
    while time.monotonic() < last:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    raise TimeoutError(f"process {pid} had not ended after {seconds:g} s")
