"""Where one training run writes, what it draws from and whom it tells."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatproof.methods.contracts.model import Model


def say_nothing(step: int, total: int, values: dict[str, float]) -> None:
    """The report that nobody reads.

    Args:
        step: Training steps that are done.
        total: Training steps of the whole run.
        values: Loss and each of its terms by name, and the number of "gaussians".
    """


def time_nothing(stage: str, seconds: float) -> None:
    """The stage clock that nobody reads.

    Args:
        stage: Name of a stage that is done.
        seconds: Wall seconds that it took.
    """


def keep_fact(name: str, value: str) -> None:
    """The facts that nobody records.

    Args:
        name: What the fact is about.
        value: What the record is to say of it.
    """


def count_nothing(name: str, count: int) -> None:
    """The counters that nobody records.

    Args:
        name: What was counted.
        count: How often it happened in the whole run.
    """


def spend_nothing(cpu_seconds: float, peak_mb: float) -> None:
    """The costs elsewhere that nobody adds.

    Args:
        cpu_seconds: What other processes and earlier runs spent for this one.
        peak_mb: Most memory that one of them took, in 2^20 bytes.
    """


def show_nobody(step: int, total: int, model: Model) -> None:
    """The model in training that nobody looks at.

    Args:
        step: Training steps that are done.
        total: Training steps of the whole run.
        model: The model; it changes with the next step.
    """


def keep_to_oneself(line: str) -> None:
    """The words that nobody hears.

    Args:
        line: One line for people.
    """


@dataclass(frozen=True, kw_only=True)
class Run:
    """Everything a fit needs beside the scene and the settings. Nothing global."""

    folder: Path | None = None
    """Checkpoints go to <folder>/checkpoint; a run found there is continued. None: none are kept."""
    seed: int = 0
    """Every random draw of the run comes from one generator with this seed."""
    backend: str = "cpu"
    """Name of the rasterizer, see splatproof.methods.contracts.backends."""
    device: str = ""
    """Torch device that model and images are kept on; empty: the backend's own."""
    threads: int | None = None
    """Threads of torch and of the kernels while fitting; None leaves them alone."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sRGB colour behind everything, each channel in [0, 1]: the protocol's."""
    report: Callable[[int, int, dict[str, float]], None] = say_nothing
    """Called as report(step, total, values) every few steps while training."""
    on_stage: Callable[[str, float], None] = time_nothing
    """Called as on_stage(stage, wall seconds) for "init" and "train", or the stages of a city; a
    continued run's seconds include those before the interruption."""
    on_fact: Callable[[str, str], None] = keep_fact
    """Called as on_fact(name, value) for what the record of the run is to say of how it was trained."""
    on_count: Callable[[str, int], None] = count_nothing
    """Called as on_count(name, number) at the end for work that was done, see
    `splatproof.methods.training.counts`; a continued run's numbers include those before the
    interruption; and for "least_visits", see `Result.counters`. Methods that train in blocks, each in a process of its
    own, count these alone."""
    on_elsewhere: Callable[[float, float], None] = spend_nothing
    """Called once as on_elsewhere(CPU seconds, peak memory in 2^20 bytes) where other processes, or earlier runs that
    share their blocks, trained parts of the model: what this process does not know of its own clock."""
    on_model: Callable[[int, int, Model], None] = show_nobody
    """Called as on_model(step, total, model) as often as `report`; it must not change the model. Methods
    that train in blocks do not call it."""
    checkpoint_seconds: float = 30.0
    """Wall seconds between checkpoints; one more is written at the end."""
    image_bytes: int = 2**30
    """Bytes for training images kept in memory and for a step on the largest of them; images beyond are
    read again each time."""
    engine: str = "processes"
    """Where the blocks of a city are trained, see splatproof.methods.city.executor."""
    workers: int = 1
    """Blocks that are trained at the same time; they share the threads."""
    cache: Path | None = None
    """Folder of trained blocks that runs may share: equal blocks are trained once. None: the run's
    own checkpoint folder."""
    say: Callable[[str], None] = keep_to_oneself
    """Called with one line for people: plans made, odd things seen."""
