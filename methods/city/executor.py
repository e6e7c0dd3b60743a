"""Train the blocks of a city, each in a process of its own that gets nothing but its job."""

import fcntl
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.processes import how_it_ended, serve_parent
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.train_block import BlockJob, train_block, trained
from splatproof.methods.training.loop import threads as torch_threads

BlocksReport = Callable[[int, int, int, dict[str, float]], None]
"""report(index, step, total, values): where the job with that index is."""
Engine = Callable[[Sequence[BlockJob], int, int | None, BlocksReport], list[BlockFacts]]
"""engine(jobs, workers, threads, report): the facts of all blocks, in the order of the jobs."""
ENGINES = {
    "processes": "splatproof.methods.city.executor:run_in_processes",
    "inline": "splatproof.methods.city.executor:run_inline",
    "ray": "splatproof.methods.city.ray_executor:run_on_ray",
}
"""Where blocks are trained: in processes here, in this process, or on a Ray cluster."""


def run_blocks(
    jobs: Sequence[BlockJob],
    *,
    engine: str = "processes",
    workers: int = 1,
    threads: int | None = None,
    report: BlocksReport,
) -> list[BlockFacts]:
    """Train all blocks; those that are trained already are not repeated.

    A block that fails stops the others; all go on from their checkpoints when this is called again.

    Args:
        jobs: One a block.
        engine: One of ENGINES.
        workers: Blocks that are trained at the same time.
        threads: Of all workers together; None: the cores of this machine.
        report: Hears where each job is.

    Raises: UsageError for an unknown engine or fewer workers than one; SplatproofError naming the
        block that failed and why.
    """
    if engine not in ENGINES:
        raise UsageError(f"engine {engine!r}: unknown, expected {', '.join(ENGINES)}")
    if workers < 1:
        raise UsageError(f"{workers} workers: expected at least 1")
    before = [trained(job) for job in jobs]
    left = [index for index, facts in enumerate(before) if facts is None]
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
    jobs: Sequence[BlockJob], workers: int, threads: int | None, report: BlocksReport
) -> list[BlockFacts]:
    """One block after the other in this process; their peak memory is then not their own."""
    del workers
    found = []
    with torch_threads(threads):
        for index, job in enumerate(jobs):
            with alone(job):
                found.append(train_block(job, lambda *at, i=index: report(i, *at)))
    return found


@dataclass
class _Running:
    index: int
    process: SpawnProcess
    says: Connection


def run_in_processes(
    jobs: Sequence[BlockJob], workers: int, threads: int | None, report: BlocksReport
) -> list[BlockFacts]:
    """Each block in a fresh process, `workers` at a time, with its share of the threads.

    The processes end when this one does, however that dies.
    """
    each = max(1, (threads or os.cpu_count() or 1) // workers)
    waiting, running = list(enumerate(jobs))[::-1], list[_Running]()
    found: dict[int, BlockFacts] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(_start(*waiting.pop(), each))
            for one in _ready(running):
                try:
                    kind, content = one.says.recv()
                except EOFError:
                    one.process.join()
                    raise SplatproofError(_died(jobs[one.index], one.process.exitcode)) from None
                if kind == "report":
                    report(one.index, *content)
                elif kind == "error":
                    raise content
                else:
                    found[one.index] = content
                    running.remove(one)
                    _end(one)
    finally:
        for one in running:
            _end(one)
    return [found[index] for index in range(len(jobs))]


def _start(index: int, job: BlockJob, threads: int) -> _Running:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, theirs, threads))
    try:
        process.start()
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise UsageError(
            f"scene {job.scene.name!r} was made in memory and cannot be sent to another process "
            f"({error}); use the engine 'inline'"
        ) from None
    theirs.close()
    return _Running(index=index, process=process, says=ours)


def _ready(running: Sequence[_Running]) -> list[_Running]:
    ready = wait([one.says for one in running])
    return [one for one in running if one.says in ready]


def _end(one: _Running) -> None:
    one.process.kill()  # nothing to say good-bye to: what it writes is written whole
    one.process.join()
    one.says.close()


def _died(job: BlockJob, code: int | None) -> str:
    what = f"block {job.facts.block}: its process {how_it_ended(code)}"
    return f"{what}; the same command continues from its checkpoint"


def _work(job: BlockJob, theirs: Connection, threads: int) -> None:
    """What a worker does: die with its parent, train, tell."""
    serve_parent()
    try:
        with torch_threads(threads), alone(job):
            facts = train_block(job, lambda *at: theirs.send(("report", at)))
    except SplatproofError as error:
        theirs.send(("error", type(error)(f"block {job.facts.block}: {error}")))
    else:
        theirs.send(("done", facts))
    finally:
        theirs.close()


@contextmanager
def alone(job: BlockJob) -> Iterator[None]:
    """Wait until no other process trains this block: a killed run's worker may be at its last step."""
    job.folder.mkdir(parents=True, exist_ok=True)
    with (job.folder / ".worker").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
