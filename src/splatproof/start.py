"""Where the command begins: signals end it in one line before anything else is imported."""

import gc
import importlib
import os
import signal
from types import FrameType

HOW = {signal.SIGINT: b"interrupted", signal.SIGTERM: b"terminated"}
"""What is said of a signal, as splatproof.cli.ending says it later."""


def main() -> int:
    """Run `bench` with the process's arguments and return the exit code."""
    for number in HOW:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as a shell sets it in the background
            signal.signal(number, _end)
    # Loading takes a while, in which ctrl-C may come. A fifth of it would go into looking for garbage among modules,
    # where there is none; splatproof.cli looks again from where a command begins.
    gc.disable()
    return importlib.import_module("splatproof.cli").main()


def _end(number: int, _: FrameType | None) -> None:
    """Leave without a traceback: nothing was begun, or all of it is done."""
    said = HOW[signal.Signals(number)]
    os.write(2, b"bench: " + said + b"; the same command continues where it stopped\n")
    os._exit(128 + number)
