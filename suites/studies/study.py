"""What a study is, and the list of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from splatbench.suites.studies import memory, partition, speed, stability


@dataclass(frozen=True, kw_only=True)
class Study:
    """A question answered by rows."""

    description: str
    columns: tuple[str, ...]
    """What a person sees; rows hold more, and --json prints all of it."""
    rows: Callable[..., Iterator[dict[str, Any]]]
    """Called with quick=True or False; a row that holds ok = False failed."""


STUDIES = {
    "stability": Study(
        description="every hard case through every implementation: error, gradient, budget",
        columns=("component", "case", "implementation", "max_abs_error", "grad_rel_l2",
                 "step_pixels", "budget", "ms", "ok", "note"),
        rows=stability.rows,
    ),
    "speed": Study(
        description="time, memory and error of everything that has a twin",
        columns=("component", "twin", "case", "forward_ms", "backward_ms", "max_abs_error",
                 "grad_rel_l2", "step_pixels", "peak_mb", "disturbed_percent", "ok", "note"),
        rows=speed.rows,
    ),
    "partition": Study(
        description="partitions of a scene side by side: balance, cut, views a block",
        columns=("scene", "k", "method", "load_std_over_mean", "load_max_over_mean", "edge_cut",
                 "views_mean", "views_max", "note"),
        rows=partition.rows,
    ),
    "memory": Study(
        description="layered memory against plain accumulation: points and guide-depth error",
        columns=("scene", "memory", "points", "guide_error", "covered", "ms"),
        rows=memory.rows,
    ),
}  # fmt: skip
