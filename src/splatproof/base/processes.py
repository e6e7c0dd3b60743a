"""Processes that work for this one: they end with it, and what became of them in words."""

import gc
import multiprocessing
import os
import signal
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, final

from splatproof.base.inside import allowing_outside, outside_is_allowed
from splatproof.base.leash import Leash, offered
from splatproof.base.plugin_files import Brought
from splatproof.base.quiet import is_quiet, silenced
from splatproof.base.signals import ENDING, held_back

FIRST = "splatproof.base.fork_server"
"""What a fork server imports before all else."""


@final
class Worker:
    """A process of its own that talks with this one, and ends when this one does.

    Use it in a `with` block, or call `close`.
    """

    def __init__(
        self, work: Callable[..., object], *arguments: Any, preload: Sequence[str] = ()
    ) -> None:
        """Start it. Ctrl-C and SIGTERM wait until it is started; it never hears ctrl-C itself.

        Args:
            work: Called in the new process as work(connection, *arguments); importable by name.
            arguments: What else it gets, sent by pickle.
            preload: Modules that are imported once for all workers of this process (those that the
                first of them names), where import costs as much as what a worker does; empty: the
                worker imports what it needs. Either way it has the environment of this moment.

        Raises: PicklingError, AttributeError or TypeError if an argument cannot be sent.
        """
        if preload:
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload([FIRST, *preload])
            environment = dict(os.environ)  # its parent's is of the moment when that was started
        else:
            context = multiprocessing.get_context("spawn")
            environment = None
        self._says, theirs = context.Pipe()
        pipe, held = context.Pipe(duplex=False)
        # plug-ins come first: what follows may be made of their classes
        told = (is_quiet(), outside_is_allowed())
        given = (Leash(pipe), Brought(), work, theirs, arguments, told, environment)
        self._process = context.Process(target=_serve, args=given)
        # also when this process ends, before multiprocessing waits for its children
        self._end = weakref.finalize(self, _end, self._process, self._says, held)
        try:
            resource_tracker.ensure_running()  # unblocks ctrl-C, so not inside `start`
            with held_back(), _without_main(), offered():
                self._process.start()
        except BaseException:
            self._end()
            raise
        finally:
            theirs.close()
            pipe.close()

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process.pid is not None
        return self._process.pid

    def send(self, message: object) -> None:
        """Say something to the worker.

        Args:
            message: Anything that pickle can send.

        Raises: EOFError if it has ended.
        """
        try:
            self._says.send(message)
        except (BrokenPipeError, ConnectionResetError):
            raise EOFError from None

    def receive(self) -> Any:
        """Wait for the next thing that the worker says.

        Raises: EOFError if it ends or closes its end without a further word.
        """
        listening([self])
        if not self._says.poll():
            raise EOFError
        try:
            return self._says.recv()
        except ConnectionResetError:  # it ended before it read what we said
            raise EOFError from None

    def how_it_ended(self) -> str:
        """Wait for the end; what became of the process, to be read after "its process"."""
        self._process.join()
        return how_it_ended(self._process.exitcode)

    def wait(self, seconds: float) -> None:
        """Wait for the end, but no longer than this.

        Args:
            seconds: How long at most.
        """
        self._process.join(seconds)

    def close(self) -> None:
        """End the process at once: what a worker writes is written whole or not at all."""
        self._end()

    def __enter__(self) -> "Worker":
        """The worker itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.close()


def listening(workers: Sequence[Worker]) -> list[Worker]:
    """Wait until some workers have something to say, or have ended.

    Args:
        workers: Those that are waited for, at least one.

    Returns: Those that have; at least one.
    """
    ready = set(wait([end for one in workers for end in (one._says, one._process.sentinel)]))
    return [one for one in workers if ready & {one._says, one._process.sentinel}]


def _end(process: BaseProcess, says: Connection, held: Connection) -> None:
    if process.pid is not None:
        process.kill()
        process.join()
    held.close()
    says.close()  # not before: the worker would say that nobody listens


@contextmanager
def _without_main() -> Iterator[None]:
    """A process that starts inside the block does not run the script again that started it.

    What workers run is importable by name; without this a script that fits at its top level would
    start itself over in every worker.
    """
    before = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = before


def _serve(
    _: Leash,
    __: Brought,
    work: Callable[..., object],
    connection: Connection,
    arguments: tuple[Any, ...],
    told: tuple[bool, bool],
    environment: dict[str, str] | None,
) -> None:
    """What a worker's process does; it knows the plug-ins of who started it, is as quiet and trusts
    the scenes that it trusts."""
    quiet, trusting = told
    serve_parent()
    gc.freeze()  # modules that are imported by now are no garbage
    gc.enable()
    if environment is not None:
        os.environ.clear()
        os.environ.update(environment)
    with connection, silenced(quiet), allowing_outside(trusting):
        work(connection, *arguments)


def serve_parent() -> None:
    """In a worker: ignore ctrl-C, which the parent hears too, and end when the parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # held back while this process started
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def how_it_ended(code: int | None) -> str:
    """What an exit code says, to be read after "its process": a signal's name, or the code.

    Args:
        code: Exit code of a process; negative: number of the signal that ended it.
    """
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = "; this is what running out of memory looks like" if name == "SIGKILL" else ""
        return f"was ended by {name}{hint}"
    return f"ended with exit code {code}"
