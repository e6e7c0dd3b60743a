"""Train the blocks of a city on a Ray cluster whose machines see the run's folder."""

import os
import pickle
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from splatproof.base.errors import MissingError, SplatproofError
from splatproof.base.plugin_files import Brought
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.executor import NO_RAY, BlocksReport, Job, alone
from splatproof.methods.training.threads import threads as torch_threads

RETRIES = 3
"""How often a block whose worker died is given to another one."""
MANY_MACHINES = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Ray's variable for whether a cluster may have a second machine; it counts on Linux too."""
POLL_SECONDS = 0.5
"""Time between two looks at what the workers report."""


def run_on_ray(
    jobs: Sequence[Job], workers: int, threads: int | None, report: BlocksReport
) -> list[BlockFacts]:
    """Train each block as a task of the cluster named by RAY_ADDRESS, or of one started here.

    One that is started here listens to this machine alone. A block whose worker or machine dies goes
    on at another from its checkpoint, so the run's folder must lie where all machines read and write
    it. A machine that falls silent counts as dead as soon as the cluster calls it so; it may train on
    unheard, for who trains a block holds its lock. A task asks for its share of the threads as CPUs.

    Args:
        jobs: One a block; what they hold must survive the way to another machine.
        workers: Most tasks at a time, at least 1.
        threads: Number that they share, each having at least one; None: one for each core of this
            machine.
        report: Hears where each job is, as report(index, step, total, values).

    Raises: MissingError without the package ray; SplatproofError naming a block that lost its worker
        more than RETRIES times, or what a block itself raised.
    """
    named = os.environ.get("RAY_ADDRESS")
    ray = _ray(alone=not named)
    each = max(1, (threads or os.cpu_count() or 1) // workers)
    started = not ray.is_initialized()
    if started:
        ray.init(address=named or "local", include_dashboard=False,
                 log_to_driver=False, configure_logging=False)  # fmt: skip
    here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
        ray.get_runtime_context().get_node_id(), soft=False
    )  # with another machine the reports would be lost, and the run with them
    reports = ray.remote(num_cpus=0, scheduling_strategy=here)(Reports).remote()
    train = ray.remote(num_cpus=each, max_retries=RETRIES)(train_remotely)
    waiting, running = list(range(len(jobs)))[::-1], dict[Any, int]()
    found: dict[int, BlockFacts] = {}
    lost, places = Counter[int](), dict[int, str]()
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                index = waiting.pop()
                packed = ray.cloudpickle.dumps((Brought(), jobs[index]))
                running[train.remote(packed, index, each, reports)] = index
            ready, _ = ray.wait(list(running), timeout=POLL_SECONDS)
            begun, told = ray.get(reports.drain.remote())
            places |= begun
            for at in told:
                report(*at)
            for one in ready:
                index = running.pop(one)
                found[index] = _facts(ray, one, jobs[index])
            for one in _stranded(ray, running, places):
                index = running.pop(one)
                ray.cancel(one, force=True)  # or the cluster would try it again, minutes later
                lost[index] += 1
                if lost[index] > RETRIES:
                    raise _lost(jobs[index], f"its machine died {lost[index]} times")
                del places[index]
                waiting.append(index)
    finally:
        for one in running:
            ray.cancel(one, force=True)
        ray.kill(reports)
        if started:
            ray.shutdown()
    return [found[index] for index in range(len(jobs))]


Progress = tuple[int, int, int, dict[str, float]]
"""Number of the job, steps that are done, steps in all, and values."""


class Reports:
    """An actor that keeps what workers report until the driver asks."""

    def __init__(self) -> None:
        """Nothing was reported yet."""
        self.waiting: list[Progress] = []
        self.begun: dict[int, str] = {}

    def begin(self, index: int, machine: str) -> None:
        """Keep where a job is trained from now on.

        Args:
            index: Number of the job among those that are run.
            machine: Ray's name of the machine.
        """
        self.begun[index] = machine

    def put(self, index: int, step: int, total: int, values: dict[str, float]) -> None:
        """Keep a worker's report.

        Args:
            index: Number of the job among those that are run.
            step: Training steps that are done.
            total: Training steps of the job.
            values: What the report says: loss, terms, number of Gaussians.
        """
        self.waiting.append((index, step, total, values))

    def drain(self) -> tuple[dict[int, str], list[Progress]]:
        """What was reported since the last call: machines of jobs that were begun, and progress."""
        out = self.begun, self.waiting
        self.begun, self.waiting = {}, []
        return out


def train_remotely(packed: bytes, index: int, threads: int, reports: Any) -> BlockFacts:
    """Train one block where Ray has put the task.

    Args:
        packed: Plug-in files, and the job, which may be made of their classes, in this order.
        index: Number by which its reports are told apart.
        threads: Torch's threads for it.
        reports: Handle of the actor that keeps the reports (Reports).
    """
    import ray

    _, job = pickle.loads(packed)
    reports.begin.remote(index, ray.get_runtime_context().get_node_id())
    with torch_threads(threads), alone(job):
        return job.work(lambda *at: reports.put.remote(index, *at))


def _facts(ray: Any, one: Any, job: Job) -> BlockFacts:
    try:
        return ray.get(one)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, SplatproofError):
            raise type(error.cause)(f"block {job.facts.block}: {error.cause}") from None
        raise
    except ray.exceptions.RayError as error:
        line = " ".join(str(error).split())[:200]
        raise _lost(job, f"{type(error).__name__}: {line}") from None


def _stranded(ray: Any, running: Mapping[Any, int], places: Mapping[int, str]) -> list[Any]:
    """Tasks on machines that the cluster calls dead.

    The cluster itself notices a task's silence minutes later: until then its connection counts as open.
    """
    dead = {node["NodeID"] for node in ray.nodes() if not node["Alive"]}
    return [one for one, index in running.items() if places.get(index) in dead]


def _lost(job: Job, why: str) -> SplatproofError:
    return SplatproofError(
        f"block {job.facts.block}: lost on the cluster ({why}); the same command continues from its checkpoint"
    )


def _ray(*, alone: bool) -> Any:
    """The package.

    Args:
        alone: Whether what it starts is to listen to this machine alone. Ray looks at the variable
            when it is first imported; by itself it listens to all the world.
    """
    if alone:
        os.environ.setdefault(MANY_MACHINES, "0")
    try:
        import ray
        import ray.exceptions
        import ray.util.scheduling_strategies
    except ImportError:
        raise MissingError(NO_RAY) from None
    return ray
