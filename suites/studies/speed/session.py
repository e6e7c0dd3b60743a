"""One twin at work, here or in a process of its own, so that its memory is its own."""

import gc
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch

from splatproof.base.errors import SplatproofError
from splatproof.base.memory import peak_memory_mb
from splatproof.base.processes import Worker
from splatproof.suites.studies.speed.judge import judge
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Component, Size, leaves_of, running


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a session works on."""

    component: str
    size: Size
    twin: str = ""
    """One to time; empty: judge all of them instead."""
    backward: bool = True
    backend: str = ""
    """Whose twins are added to the registry's (suites/twins/cuda.py); empty: nobody's."""


@runtime_checkable
class Session(Protocol):
    """Something that answers for a task."""

    def ask(self, *request: Any) -> Any:
        """The answer to "turn" seconds, "memory", "pairs" or "judge"."""
        ...

    @property
    def pid(self) -> int:
        """The process that it runs in."""
        ...

    def close(self) -> None:
        """End it."""
        ...


Open = Callable[[Task], Session]


class Here:
    """A session in this process."""

    def __init__(self, task: Task) -> None:
        """Make the problem and, where one twin is timed, its forward pass."""
        self.task = task
        self.component = with_backend(task.component, task.backend)
        self.problem = self.component.problem(task.size)
        self.pid = os.getpid()
        if not task.twin:
            return
        self.twin = next(twin for twin in self.component.twins if twin.name == task.twin)
        self.leaves = leaves_of(self.problem, self.twin)
        with running(self.twin):
            self.forward = self.twin.start(self.problem, self.leaves)
        self.cotangent: torch.Tensor | None = None
        gc.collect()
        self.held, self.warm = forget_peak(), False

    def _run(self) -> tuple[float, float]:
        """Milliseconds of one forward and one backward pass (nan without one)."""
        for leaf in self.leaves.values():
            leaf.grad = None
        start = time.perf_counter()
        if not self.task.backward:
            with torch.no_grad():
                self.forward()
            self.twin.finish()
            return 1e3 * (time.perf_counter() - start), float("nan")
        value = self.forward()
        self.twin.finish()
        middle = time.perf_counter()
        if self.problem.cotangent is None:
            return 1e3 * (middle - start), float("nan")
        if self.cotangent is None:
            self.cotangent = self.problem.cotangent.to(value)
        value.backward(self.cotangent)
        self.twin.finish()
        return 1e3 * (middle - start), 1e3 * (time.perf_counter() - middle)

    def ask(self, *request: Any) -> Any:
        """See Session."""
        if request[0] == "turn":
            with running(self.twin):
                return self._turn(request[1])
        if request[0] == "memory":
            peak = peak_memory_mb()
            device = self.twin.device_mb() if self.twin.device_mb else None
            return {"peak_mb": peak, "added_mb": peak - self.held, "device_mb": device}
        if request[0] == "pairs":
            return self.problem.pairs() if self.problem.pairs else None
        return judge(self.component, self.problem)

    def _turn(self, seconds: float) -> list[tuple[float, float]]:
        """Runs for so many seconds, at least one; one before them is not counted.

        A twin whose single run is longer than a turn is warmed up in its first turn only.
        """
        begin = time.perf_counter()
        runs = [self._run()]
        if not self.warm or time.perf_counter() - begin < seconds:
            runs = [self._run()]
        self.warm = True
        end = begin + seconds
        while time.perf_counter() < end:
            runs.append(self._run())
        return runs

    def close(self) -> None:
        """Nothing to end."""


class Process:
    """A session in a process of its own."""

    def __init__(self, task: Task) -> None:
        """Start it.

        Raises: SplatproofError if it ends before it is ready, e.g. for lack of memory.
        """
        self._task = task
        self._worker = Worker(_serve, task, preload=[__name__])
        self.pid = self._worker.pid
        self._answer()

    def ask(self, *request: Any) -> Any:
        """See Session."""
        with suppress(EOFError):  # it has ended; what it said last is the answer
            self._worker.send(request)
        return self._answer()

    def _answer(self) -> Any:
        try:
            answer = self._worker.receive()
        except EOFError:
            raise SplatproofError(
                f"{self._task}: its process {self._worker.how_it_ended()}"
            ) from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        self._worker.close()


def _serve(says: Connection, task: Task) -> None:
    """What the process does: answer until nobody asks any more."""
    try:
        session = Here(task)
        says.send(None)
        while True:
            says.send(session.ask(*says.recv()))
    except EOFError:
        return
    except (SplatproofError, ValueError, RuntimeError, MemoryError) as error:
        says.send(error)  # raised by the parent


def with_backend(name: str, backend: str) -> Component:
    """A component of the registry, with the twins of a further backend where one is asked for.

    Args:
        name: Name of the component in suites/twins/registry.py.
        backend: Name of the further backend; empty: none.
    """
    if not backend:
        return COMPONENTS[name]
    from splatproof.suites.twins.cuda import with_cuda

    return with_cuda(COMPONENTS[name])


def forget_peak() -> float:
    """Let the peak memory of this process start anew where the system can; what it is now."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass  # then the peak is that of the whole life of the process
    return peak_memory_mb()
