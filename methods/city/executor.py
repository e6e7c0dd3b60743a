"""Train the blocks of a city, or refine its parts, each in a process of its own that gets nothing but its job."""

import os
import pickle
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from importlib import import_module
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol, runtime_checkable

from splatproof.base.errors import MissingError, SplatproofError, UsageError
from splatproof.base.locks import locked
from splatproof.base.processes import Worker, listening
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.block_work import STEP_COST
from splatproof.methods.city.train_block import Report
from splatproof.methods.training.threads import threads as torch_threads
from splatproof.reference.partition.block_time import block_seconds
from splatproof.reference.types.scene import Scene


@runtime_checkable
class Job(Protocol):
    """What is to be done for one block, wherever that is."""

    @property
    def scene(self) -> Scene:
        """The views that it needs, and no others."""
        ...

    @property
    def facts(self) -> BlockFacts:
        """Which block it is, and what its time goes by."""
        ...

    @property
    def folder(self) -> Path:
        """Folder of this job alone."""
        ...

    def done(self) -> BlockFacts | None:
        """What it has cost; None if it is not done."""
        ...

    def work(self, report: Report) -> BlockFacts:
        """Do it, or go on with it; what is done is not repeated.

        Args:
            report: Called as report(step, total, values) every few steps.
        """
        ...


BlocksReport = Callable[[int, int, int, dict[str, float]], None]
"""report(index, step, total, values): where the job with that index is."""
Engine = Callable[[Sequence[Job], int, int | None, BlocksReport], list[BlockFacts]]
"""engine(jobs, workers, threads, report): the facts of all blocks, in the order of the jobs."""
PRELOAD = (__name__,)
"""Imported once for all blocks, which may be many and short."""
ENGINES = {
    "processes": "splatproof.methods.city.executor:run_in_processes",
    "inline": "splatproof.methods.city.executor:run_inline",
    "ray": "splatproof.methods.city.ray_executor:run_on_ray",
}
"""Where blocks are trained: in processes here, in this process, or on a Ray cluster."""
NO_RAY = "the engine 'ray' needs the package ray; run `pip install splatproof[distributed]`"
"""What is said where that is missing."""


def check_engine(engine: str, workers: int) -> None:
    """Refuse, before anything is trained, what `run_blocks` could not run.

    Args:
        engine: Expected to be one of ENGINES.
        workers: Expected to be at least 1.

    Raises: UsageError for either; MissingError for "ray" without its package.
    """
    if engine not in ENGINES:
        raise UsageError(f"engine {engine!r}: unknown, expected {', '.join(ENGINES)}")
    if workers < 1:
        raise UsageError(f"{workers} workers: expected at least 1")
    if engine == "ray" and find_spec("ray") is None:
        raise MissingError(NO_RAY)


def run_blocks(
    jobs: Sequence[Job],
    *,
    engine: str = "processes",
    workers: int = 1,
    threads: int | None = None,
    report: BlocksReport,
) -> list[BlockFacts]:
    """Train all blocks, those first that will take longest; those that are trained already are not repeated.

    A block that fails stops the others; all go on from their checkpoints when this is called again.

    Args:
        jobs: One a block.
        engine: One of ENGINES.
        workers: Blocks that are trained at the same time.
        threads: Number that all workers share; None: one for each core of this machine (inline:
            what torch has).
        report: Hears where each job is, as report(index, step, total, values).

    Raises: As `check_engine` does; SplatproofError naming the block that failed and why.

    Source: longest first: Graham 1969.
    """
    check_engine(engine, workers)
    before = [job.done() for job in jobs]
    left = [index for index, facts in enumerate(before) if facts is None]
    left.sort(key=lambda index: -block_seconds(jobs[index].facts.work, STEP_COST))
    if left:
        module, name = ENGINES[engine].split(":")
        run: Engine = getattr(import_module(module), name)
        found = run(
            [jobs[index] for index in left], workers, threads,
            lambda i, step, total, values: report(left[i], step, total, values),
        )  # fmt: skip
        for index, facts in zip(left, found, strict=True):
            before[index] = facts
    return [facts for facts in before if facts is not None]


def run_inline(
    jobs: Sequence[Job], workers: int, threads: int | None, report: BlocksReport
) -> list[BlockFacts]:
    """Train one block after the other in this process, whose memory theirs is then part of.

    Args:
        jobs: One a block.
        workers: Not looked at: there is one.
        threads: Torch's threads; None leaves torch what it has.
        report: Hears where each job is, as report(index, step, total, values).
    """
    del workers
    found = []
    with torch_threads(threads):
        for index, job in enumerate(jobs):
            with alone(job):
                found.append(
                    job.work(lambda step, total, values, i=index: report(i, step, total, values))
                )
    return found


def run_in_processes(
    jobs: Sequence[Job], workers: int, threads: int | None, report: BlocksReport
) -> list[BlockFacts]:
    """Train each block in a fresh process with its share of the threads.

    The processes end when this one does, however that dies.

    Args:
        jobs: One a block; what they hold must survive the way to another process.
        workers: Number of processes at a time, at least 1.
        threads: Number that they share, each having at least one; None: one for each core.
        report: Hears where each job is, as report(index, step, total, values).

    Raises: UsageError for a scene that exists in this process only; SplatproofError for a process
        that died, or what a block raised, either naming the block.
    """
    each = max(1, (threads or os.cpu_count() or 1) // workers)
    waiting, running = list(enumerate(jobs))[::-1], dict[Worker, int]()
    found: dict[int, BlockFacts] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                index, job = waiting.pop()
                running[_start(job, each)] = index
            for one in listening(list(running)):
                index = running[one]
                try:
                    kind, content = one.receive()
                except EOFError:
                    raise SplatproofError(_died(jobs[index], one.how_it_ended())) from None
                if kind == "report":
                    report(index, *content)
                elif kind == "error":
                    raise content
                else:
                    found[index] = content
                    del running[one]
                    one.close()
    finally:
        for one in running:
            one.close()
    return [found[index] for index in range(len(jobs))]


def _start(job: Job, threads: int) -> Worker:
    try:
        return Worker(_work, job, threads, preload=PRELOAD)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise UsageError(
            f"scene {job.scene.name!r} was made in memory and cannot be sent to another process "
            f"({error}); use the engine 'inline'"
        ) from None


def _died(job: Job, how: str) -> str:
    what = f"block {job.facts.block}: its process {how}"
    return f"{what}; the same command continues from its checkpoint"


def _work(says: Connection, job: Job, threads: int) -> None:
    """What a worker does: train, tell."""
    try:
        with torch_threads(threads), alone(job):
            facts = job.work(lambda *at: says.send(("report", at)))
    except SplatproofError as error:
        says.send(("error", type(error)(f"block {job.facts.block}: {error}")))
    except OSError as error:  # a full disk, say
        where = f"{error.filename}: " if error.filename else ""
        said = f"block {job.facts.block}: {where}{error.strerror or error}"
        again = "when that is mended the same command continues from its checkpoint"
        says.send(("error", MissingError(f"{said}; {again}")))
    else:
        says.send(("done", facts))


def alone(job: Job) -> AbstractContextManager[None]:
    """Wait until no other process trains this block: a killed run's worker may be at its last step."""
    return locked(job.folder / ".worker")
