"""Run a case here or in a process of its own."""

import fcntl
import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path

from splatproof.base.errors import UsageError
from splatproof.base.processes import how_it_ended, serve_parent
from splatproof.suites.records import RECORD_NAME, write_record
from splatproof.suites.run_case import Job, Tell, failed_result, run_case

Launch = Callable[[Job, Tell], None]
"""Runs a job to its record; `tell` hears where it is."""


def in_process(job: Job, tell: Tell) -> None:
    """Run the case here."""
    run_case(job, tell)


def in_worker(job: Job, tell: Tell, *, target: Launch = run_case) -> None:
    """Run the case in a fresh process, which costs some seconds of imports.

    Its peak memory is then its own, a crash (out of memory, a fault in native code) fails one case
    and not the suite, and nothing leaks from case to case. The process ends when this one does,
    however that dies.

    Args:
        job: What to run.
        tell: Called here with what the case reports there.
        target: What runs there; importable by name.
    """
    (job.folder / RECORD_NAME).unlink(missing_ok=True)  # one that is there afterwards is new
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    worker = context.Process(target=_work, args=(target, job, theirs))
    worker.start()
    theirs.close()
    try:
        _listen(ours, worker.sentinel, tell)
        worker.join()
    finally:
        ours.close()
        worker.kill()  # nothing to say good-bye to: what it writes is written whole
        worker.join()
    if not (job.folder / RECORD_NAME).exists():
        reason = f"the case's process left no record: it {how_it_ended(worker.exitcode)}"
        write_record(job.folder, failed_result(job, reason))


def _listen(ours: Connection, sentinel: int, tell: Tell) -> None:
    """Pass on what the worker says until it is silent for good."""
    while True:
        ready = wait([ours, sentinel])
        if ours not in ready:
            return
        try:
            tell(*ours.recv())
        except EOFError:
            return


def _work(target: Launch, job: Job, theirs: Connection) -> None:
    """What the worker does: die with its parent, be alone in the suite's folder, run."""
    serve_parent()
    job.folder.mkdir(parents=True, exist_ok=True)
    # The worker of a killed run may still be at its last step: wait until its lock is gone.
    with (job.folder / ".worker").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        target(job, lambda *event: theirs.send(event))


class Lock:
    """The right to run a suite in a folder; the kernel frees it when the process dies."""

    def __init__(self, folder: Path) -> None:
        """Take the lock.

        Raises: UsageError if another process has it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / ".lock").open("w")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise UsageError(
                f"{folder}: another `bench run` is using this folder; wait for it or use --out"
            ) from None

    def __enter__(self) -> None:
        """Nothing: the lock was taken when this was made."""

    def __exit__(self, *_: object) -> None:
        """Give the lock back."""
        self._file.close()
