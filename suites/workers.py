"""Run a case here or in a process of its own."""

import os
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection

from splatproof.base.locks import locked
from splatproof.base.processes import Worker
from splatproof.suites.records import RECORD_NAME, write_record
from splatproof.suites.run_case import Job, Tell, failed_result, run_case

PRELOAD = ("splatproof.suites.run_case",)
"""Imported once for all cases of a run: most of what a short case would cost."""
AT_REST = 5.0
"""Seconds in which a process whose case is over ends by itself: a method may have left a thread that never does."""
Launch = Callable[[Job, Tell], None]
"""launch(job, tell): runs a job to its record; `tell` hears where it is."""


def in_process(job: Job, tell: Tell) -> None:
    """Run the case in this process.

    Args:
        job: What to run.
        tell: Hears where the case is.
    """
    run_case(job, tell)


def in_worker(job: Job, tell: Tell, *, target: Launch = run_case) -> None:
    """Run the case in a fresh process; the imports, some seconds, are made once for all cases.

    Its peak memory is then its own, a crash (out of memory, a fault in native code) fails one case
    and not the suite, and nothing leaks from case to case. The process ends when this one does,
    however that dies.

    Args:
        job: What to run.
        tell: Called in this process with what the case reports in the other.
        target: What the other process runs; importable by name.
    """
    (job.folder / RECORD_NAME).unlink(missing_ok=True)  # one that is there afterwards is new
    with Worker(_work, target, job, preload=PRELOAD) as worker:
        with suppress(EOFError):
            while True:
                tell(*worker.receive())
        if (job.folder / RECORD_NAME).exists():
            worker.wait(AT_REST)
            return
        ended = worker.how_it_ended()
    write_record(job.folder, failed_result(job, f"the case's process left no record: it {ended}"))


def _work(says: Connection, target: Launch, job: Job) -> None:
    """What the worker does: be alone in the case's folder, run."""
    # what a method prints is no result of the command, whose stdout may be read line by line
    os.dup2(2, 1)
    # The worker of a killed run may still be at its last step: wait until its lock is gone.
    try:
        with locked(job.folder / ".worker"):
            target(job, lambda *event: says.send(event))
    except OSError:  # the disk takes no record: who waits for it meets the same, and tells it
        raise SystemExit(1) from None
