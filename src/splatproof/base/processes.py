"""Processes that work for this one: they end with it, and what became of them in words."""

import multiprocessing
import os
import signal
import threading


def serve_parent() -> None:
    """In a worker: ignore ctrl-C, which the parent hears too, and end when the parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def how_it_ended(code: int | None) -> str:
    """What an exit code says, to be read after "its process": a signal's name, or the code."""
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = "; this is what running out of memory looks like" if name == "SIGKILL" else ""
        return f"was ended by {name}{hint}"
    return f"ended with exit code {code}"
