"""What a component with several implementations is, and how one of them is called."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof import _ext

Size = tuple[int, ...]
"""What a problem is made from, e.g. Gaussians, width, height."""
Leaves = dict[str, Tensor]
Forward = Callable[[], Tensor]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What all twins of a component are given in one case; every number follows from the size."""

    leaves: Leaves
    """Float32 tensors that outputs depend on; gradients are by these."""
    given: Mapping[str, Any] = field(default_factory=dict)
    """Everything else."""
    cotangent: Tensor | None = None
    """d loss / d output of the backward pass; None: there is no backward pass."""
    discontinuities: Callable[[], Bool[Tensor, "..."]] | None = None
    """Marks outputs on which rounding may decide; they are not judged. None: there are none."""
    pairs: Callable[[], int] | None = None
    """Counts the pairs of Gaussian and pixel that contribute, where there are such."""


def at_once() -> None:
    """What a twin that runs on the CPU has to wait for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Twin:
    """One implementation. Registering it (suites/twins/registry.py) times, judges and tests it."""

    name: str
    start: Callable[[Problem, Leaves], Forward]
    """Called once with the problem and its leaves, in this twin's dtype and asking for gradients
    where the problem has a backward pass; returns the forward pass, which is called many times. A twin on a device puts its own leaves
    there into the dictionary."""
    dtype: torch.dtype = torch.float32
    approximates: str = ""
    """What this twin gives up for speed. It shows its error and has no budget."""
    level: str | None = None
    """SIMD level to run at; None: the one in use."""
    threads: int | None = None
    """Threads to run on; None: as many as torch has."""
    most: int | None = None
    """Largest first number of a case's size that it is timed at; None: any. At the size that all are
    judged at it is timed anyway."""
    finish: Callable[[], None] = at_once
    """Returns when the device has done what it was asked to."""
    device_mb: Callable[[], float] | None = None
    """Peak memory on a device of its own, in 2^20 bytes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One size that twins are timed at."""

    size: Size
    quick: bool = False
    """Whether the reduced form of the study has it too."""
    forward_only: bool = False
    """Leave the backward pass out."""
    growth: bool = False
    """Only the component's `usual` twin, and those on a device of their own: how cost grows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Component:
    """Something that has a float64 reference and twins."""

    name: str
    problem: Callable[[Size], Problem]
    reference: Twin | None
    """The truth, in float64; None: there is no truth, only time."""
    twins: tuple[Twin, ...]
    usual: str
    """The twin that users get."""
    judged: Size
    """Size at which all twins are held against the reference, and timed side by side."""
    tiny: Size
    """Size at which the tests do."""
    cases: tuple[Case, ...] = ()
    """Further sizes that twins are timed at."""
    max_abs_error: float = 2e-5
    """Budget of twins that approximate nothing."""
    grad_rel_l2: float = 1e-3
    label: Callable[[Size], str] = lambda size: " ".join(map(str, size))
    """How a size is shown."""


def functional(call: Callable[[Leaves, Mapping[str, Any]], Tensor]) -> Callable[..., Forward]:
    """The `start` of a twin that is a function of leaves and the rest, without state."""

    def start(problem: Problem, leaves: Leaves) -> Forward:
        return lambda: call(leaves, problem.given)

    return start


def leaves_of(problem: Problem, twin: Twin) -> Leaves:
    """Fresh copies of the problem's leaves as the twin wants them.

    Args:
        problem: Problem whose leaves are copied.
        twin: Implementation they are for; it says which dtype.
    """
    needs = problem.cotangent is not None
    return {
        name: value.detach().to(twin.dtype, copy=True).requires_grad_(needs)
        for name, value in problem.leaves.items()
    }


@contextmanager
def running(twin: Twin) -> Iterator[None]:
    """The twin's SIMD level and threads inside, and what was there before afterwards."""
    level, threads = _ext.simd_level(), torch.get_num_threads()
    _ext.set_simd_level(twin.level or level)
    torch.set_num_threads(twin.threads or threads)
    try:
        yield
    finally:
        _ext.set_simd_level(level)
        torch.set_num_threads(threads)
