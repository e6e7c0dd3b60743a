"""What a study is, and the list of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatproof.methods.storage.packed.writer import PARTS
from splatproof.suites.studies import (
    balance,
    balance_plot,
    blind,
    matching,
    matching_page,
    memory,
    partition,
    priors,
    seen,
    size,
    size_page,
    size_plot,
    stability,
    stability_plot,
)  # fmt: skip
from splatproof.suites.studies.instructions import measure as instructions
from splatproof.suites.studies.speed import measure as speed
from splatproof.suites.studies.speed import page as speed_page


@dataclass(frozen=True, kw_only=True)
class Study:
    """A question answered by rows."""

    description: str
    columns: tuple[str, ...]
    """What a person sees; rows hold more, and --json prints all of it."""
    rows: Callable[..., Iterator[dict[str, Any]]]
    """Called with quick=True or False; a row that holds ok = False failed."""
    options: frozenset[str] = frozenset()
    """Which of "wait", "backend", "only", "runs" and "roma" `rows` takes too."""
    resumes: bool = False
    """Whether `rows` takes the rows of an earlier call that was ended (kept=)."""
    pictures: Callable[[Sequence[dict[str, Any]], Path], list[Path]] | None = None
    """Draws the rows into a folder and returns the files."""
    page: Callable[[Mapping[str, str], Sequence[dict[str, Any]], Sequence[str]], str] | None = None
    """The Markdown page of machine, rows and the pictures' paths relative to it."""
    logged: bool = False
    """Whether the rows go to the tracking store too."""


STUDIES = {
    "stability": Study(
        description="every hard case through every implementation: error, gradient, budget",
        columns=("component", "case", "implementation", "max_abs_error", "grad_rel_l2",
                 "discontinuity_pixels", "budget", "ms", "ok", "note"),
        rows=stability.rows, pictures=stability_plot.draw,
    ),
    "speed": Study(
        description="time, memory and error of everything that has a twin",
        columns=("component", "twin", "case", "forward_ms", "backward_ms", "ratio", "ratio_low",
                 "ratio_high", "max_abs_error",
                 "rms_error", "grad_rel_l2", "discontinuity_pixels", "peak_mb", "share", "value", "unit",
                 "disturbed_percent", "ok", "note"),
        rows=speed.rows, options=frozenset({"wait", "backend", "only"}), resumes=True,
        pictures=speed.pictures,
        page=speed_page.page, logged=True,
    ),
    "instructions": Study(
        description="instructions of fixed kernel work, counted by valgrind, against the baseline's",
        columns=("workload", "instructions", "per_gaussian", "per_pair", "per_pixel", "per_anchor",
                 "simd", "repeats", "change", "ok", "note"),
        rows=instructions.rows,
    ),
    "partition": Study(
        description="partitions of a scene side by side: balance, cut, views a block",
        columns=("scene", "k", "method", "load_std_over_mean", "load_max_over_mean", "edge_cut",
                 "views_mean", "views_max", "note"),
        rows=partition.rows,
    ),
    "balance": Study(
        description="processor seconds of blocks with 300,000 Gaussians and more, partition by partition",
        columns=("scene", "partition", "gaussians", "views", "predicted", "max_over_mean", "low", "high",
                 "equal_steps", "slowest", "total", "cut_seconds", "note"),
        rows=balance.rows, pictures=balance_plot.draw,
    ),
    "blind": Study(
        description="whether a small classifier that was shown hard-cut seams finds those of other merges",
        columns=("scene", "trained_on", "merge", "seeds", "crops", "told", "low", "high"),
        rows=blind.rows, options=frozenset({"runs"}), pictures=blind.draw,
    ),
    "size": Study(
        description="bytes of trained models against what they cost: our files, .spz, .sog, images, .ply",
        columns=("scene", "format", "bytes_each", "psnr_change", "seen_change", "psnr_to_model",
                 "write_millions_s", "read_millions_s", *PARTS, "note"),
        rows=size.rows, pictures=size_plot.draw, page=size_page.page, logged=True,
    ),
    "memory": Study(
        description="layered memory against plain accumulation: points and guide-depth error",
        columns=("scene", "memory", "points", "guide_error", "covered", "ms"),
        rows=memory.rows,
    ),
    "priors": Study(
        description="depth priors against true depth on street and tunnel, scale and zero put right",
        columns=("scene", "prior", "views", "abs_rel", "delta1", "rank", "valid", "note"),
        rows=priors.rows, pictures=priors.draw, logged=True,
    ),
    "matching": Study(
        description="points of matched photos against true depth, a threshold moved at a time",
        columns=("scene", "threshold", "value", "domain", "pairs", "points", "points_a_pair", "median_error", "wrong",
                 "seconds"),
        rows=matching.rows, options=frozenset({"roma"}), page=matching_page.page,
    ),
    "seen": Study(
        description="what training photos show of held-out views: by sparse points and in truth",
        columns=("scene", "protocol", "views", "seen_in_truth", "seen_by_points",
                 "called_unseen_wrongly", "called_seen_wrongly", "least_seen", "views_by_rule",
                 "least_by_rule", "seen_by_rule", "note"),
        rows=seen.rows, pictures=seen.draw,
    ),
}  # fmt: skip
