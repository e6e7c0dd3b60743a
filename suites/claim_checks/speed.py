"""Ratios of times: two implementations of one component in turns, in one process."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from splatproof.base.errors import MissingError
from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.studies.speed.measure import TURN_SECONDS
from splatproof.suites.studies.speed.session import Here, Task
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Size

REPETITIONS, QUICK_REPETITIONS = 15, 3
"""Turns of each of the two; 15 of them enclose the median by the 4th and the 12th."""


def ratio(
    component: str, size: Size, slow: str, fast: str, *, reduced: bool, folder: Path
) -> Measurement:
    """How many times as long `slow` takes as `fast`, forward and, where there is one, backward.

    In each repetition both have their turn, one after the other, so that what else the machine does
    meets both. A twin's first runs are not counted.

    Args:
        component: Name of the component, see splatproof.suites.twins.registry.
        size: Size of the problem.
        slow: Twin that is expected to take longer.
        fast: Twin that is expected to take less.
        reduced: Fewer repetitions.
        folder: Not written to.
    Raises: MissingError for a twin that this machine does not have.
    """
    del folder
    names = [twin.name for twin in COMPONENTS[component].twins]
    for name in (slow, fast):
        if name not in names:
            raise MissingError(f"{component} has no {name} on this machine: {', '.join(names)}")
    both = [Here(Task(component=component, size=size, twin=name)) for name in (slow, fast)]
    for session in both:
        session.ask("turn", 0.0)  # warm
    values = []
    for _ in range(QUICK_REPETITIONS if reduced else REPETITIONS):
        slow_ms, fast_ms = (shortest(session.ask("turn", TURN_SECONDS)) for session in both)
        values.append(slow_ms / fast_ms)
    label = COMPONENTS[component].label(size)
    return Measurement(
        values=tuple(values),
        compared=f"{slow} over {fast}, {label}, in turns in one process",
    )


def shortest(runs: Sequence[tuple[float, float]]) -> float:
    """Milliseconds of the fastest run of a turn, both ways.

    Args:
        runs: Milliseconds forward and backward of each run; nan where there is no way back.
    """
    return min(forward + (0.0 if math.isnan(backward) else backward) for forward, backward in runs)


def _timed(component: str, size: Size, slow: str, fast: str) -> Callable[[bool, Path], Measurement]:
    def measure(reduced: bool, folder: Path) -> Measurement:
        return ratio(component, size, slow, fast, reduced=reduced, folder=folder)

    return measure


CPU = COMPONENTS["rasterizer"].usual
LOSS = COMPONENTS["loss"].usual
SPEED = {
    "rasterizer_speed": Check(
        measure=_timed("rasterizer", (1_000, 64, 48), "torch dense", CPU), unit="times",
        seconds=(12.0, 4.0),
    ),
    "simd_speed": Check(
        measure=_timed("rasterizer", (20_000, 320, 240), "cpu portable", CPU), unit="times",
        seconds=(3.0, 1.0),
    ),
    "decoding_speed": Check(
        measure=_timed("anchors", (5_000,), "torch", "cpu"), unit="times", seconds=(5.0, 1.5),
    ),
    "loss_speed": Check(
        measure=_timed("loss", (320, 240), "torch", LOSS), unit="times", seconds=(5.0, 1.5),
    ),
    "adam_speed": Check(
        measure=_timed("adam", (10_000,), "torch foreach", "cpu"), unit="times",
        seconds=(1.0, 0.5),
    ),
    "rank_speed": Check(
        measure=_timed("soft rank", (4_000,), "direct", "sorted"), unit="times",
        seconds=(2.0, 1.0),
    ),
}  # fmt: skip
