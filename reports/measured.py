"""What verdicts and pages need of a finished case, as plain data that can be committed."""

import hashlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from statistics import fmean
from typing import Any

from splatproof.base.errors import DataError
from splatproof.reference.types.result import Result

LATE = 0.2
"""Share of a run's steps that is its end, and that is compared with the same share before it."""
COUNT = "gaussians"
"""What the training loop calls the number of primitives in a curve."""
LOSSES = ("photometric", "loss")
"""What it calls the difference between render and photo, and the sum with all other terms, which counts
where a method has no plain difference."""
MB = 2**20
OF_ALL_PROCESSES = ("cpu_seconds", "peak_memory_mb")
"""Costs that old records say of the first process alone, see `Measured.blocks_uncounted`."""
COUNTED = 0.5
"""Least share of the wall seconds of coarse model and blocks that the processor seconds of a case are. It is 1 where every
thread has a core, and was 0.7 in the most disturbed run that docs/city.json holds. Records without the blocks lie below it
where these were most of the work; docs/city.json and docs/unseen.json say so themselves, by the commit that a row came with."""
DIGITS = 6
"""Significant digits that are kept of each number."""
Curve = Sequence[tuple[int, Mapping[str, float]]]
"""Pairs (step, values by name), as Result.curve."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One case of a suite and its numbers."""

    scene: str
    row: str
    """What tables call the method with its settings: method@variant~axes, see `row_name`."""
    protocol: str
    seed: int
    steps: int
    """Training steps."""
    settings: dict[str, Any] = field(default_factory=dict)
    """The method's settings by name; empty: not known."""
    error: str = ""
    """One line saying why the case failed; empty for a finished one."""
    machine: str = ""
    """Where times were measured."""
    data: str = ""
    """Hash of the split and of the pixels of all truth images: cases that differ in it are not compared."""
    grown: int = 0
    """How often the number of primitives went up between two points of the curve, 1 where some were added
    and the number never went up; of a scene trained in blocks how often the block was densified that was so
    least. -1: not known."""
    late_gain: float = 0.0
    """What the end of the run still gained in training: 20 log10 of the mean loss of the fifth before
    the last over that of the last, dB. Infinite where the curve is too short to say; 0 of a failed case."""
    counters: dict[str, int] = field(default_factory=dict)
    """Work that was done by name, see Result; exact, and compared only where code ran at the same SIMD
    level."""
    values: dict[str, float] = field(default_factory=dict)
    """Metrics and costs of the whole case by name; what is undefined is left out."""
    blocks_uncounted: bool = False
    """Whether it was recorded before the processes that train blocks were counted: what it says of processor
    seconds and peak memory is that of the first process alone, and is left out of `values`."""
    turns: str = ""
    """Session in which `render_ms` was taken in turns with others, see Result; "": in none."""
    images: dict[str, dict[str, float]] = field(default_factory=dict)
    """Metrics of each scored image by name; what is undefined is left out."""

    def named(self, variant: str = "", *, axes: str | None = None) -> str:
        """The row of this method with another variant.

        Args:
            variant: Name of the variant; empty: none.
            axes: Noise and prior, as they stand behind the variant; None: this row's own.
        """
        name, tilde, own = self.row.partition("~")
        method = name.partition("@")[0]
        ending = tilde + own if axes is None else axes
        return (f"{method}@{variant}" if variant else method) + ending


def measured(result: Result) -> Measured:
    """A result with what verdicts and pages need, numbers rounded to DIGITS."""
    in_blocks = _blocks(result)
    values = dict(result.metrics) | {
        "primitives": float(result.primitives),
        "disk_mb": result.bytes_on_disk / MB,
        "render_ms": result.render_ms,
        "train_seconds": result.training_seconds,
        "cpu_seconds": result.cpu_seconds,
        "peak_memory_mb": result.peak_memory_mb,
        "points": math.nan if in_blocks else begun_with(result.curve),
    }
    if not in_blocks:  # more machines do not train one model sooner
        values["four_machine_seconds"] = result.training_seconds
        values["four_machine_cpu_seconds"] = result.cpu_seconds
    uncounted = _blocks_uncounted(result)
    if uncounted:
        values = {name: value for name, value in values.items() if name not in OF_ALL_PROCESSES}
    machine = (f"{k} {result.environment[k]}" for k in ("cores", "simd", "backend")
               if k in result.environment)  # fmt: skip
    return Measured(
        scene=result.scene,
        row=result.row,
        protocol=result.protocol,
        seed=result.seed,
        steps=int(str(result.settings.get("iterations", 0))),
        settings=json.loads(json.dumps(result.settings)),
        error=result.error,
        machine=", ".join(machine),
        data=data_digest(result),
        grown=_grown(result),
        late_gain=0.0 if result.error else _rounded(late_gain(result.curve)),
        counters=dict(sorted(result.counters.items())),
        values=_finite(values),
        blocks_uncounted=uncounted,
        turns=result.turns,
        images={image.name: _finite(image.metrics) for image in result.images},
    )


def measured_row(row: Mapping[str, Any]) -> Measured:
    """A committed row as it was written; what pages add to it is left out, what old ones lack is not known.

    Args:
        row: A JSON object of a page's rows.
    Raises: DataError for one that is no row.
    """
    names = {one.name for one in fields(Measured)}
    try:
        old: dict[str, Any] = {
            "steps": row.get("iterations", 0),
            "grown": -1,
            "late_gain": math.inf,
        }
        plain = old | {name: value for name, value in row.items() if name in names}
        return Measured(**plain)
    except (AttributeError, TypeError) as error:
        raise DataError(f"not a row of measured values ({error}): {str(row)[:80]}") from None


def data_digest(result: Result) -> str:
    """Short hash of the split and of the names and pixels of all scored images."""
    truths = [(image.name, image.truth_sha256) for image in result.images]
    text = json.dumps([result.split_sha256, truths])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def times_grown(curve: Curve) -> int:
    """How often the number of primitives went up from one point of a curve to the next."""
    counts = [values[COUNT] for _, values in curve if COUNT in values]
    return sum(after > before for before, after in itertools.pairwise(counts))


def begun_with(curve: Curve) -> float:
    """Number of primitives at the first point of a curve, which comes before the first densification of all
    but the shortest runs; nan where no point says it."""
    return next((values[COUNT] for _, values in curve if COUNT in values), math.nan)


def loss_points(curve: Curve) -> list[tuple[int, float]]:
    """Pairs (step, loss) of a curve: of the first of LOSSES that it has."""
    for name in LOSSES:
        if points := [(step, values[name]) for step, values in curve if name in values]:
            return points
    return []


def late_gain(curve: Curve) -> float:
    """dB by which the loss of the last LATE of a run's steps lies below that of as many before them.

    A loss is near to a mean of absolute differences, so its ratio reads as one of amplitudes: 20 log10.
    Points are single steps, each of one view: with 200 points of 27 views of the street it scatters by
    about 0.4 dB.

    Args:
        curve: Pairs (step, values by name) of a whole run.
    Returns: Infinity where one of the two parts has no point.
    Source: ours.
    """
    losses = loss_points(curve)
    end = losses[-1][0] if losses else 0
    parts: tuple[list[float], list[float]] = ([], [])
    for step, loss in losses:
        back = (end - step) / end if end else math.inf
        if back < 2 * LATE:
            parts[back < LATE].append(loss)
    before, last = parts
    if not before or not last or fmean(last) <= 0:
        return math.inf
    return 20 * math.log10(fmean(before) / fmean(last))


def _grown(result: Result) -> int:
    """How often the model grew; of blocks, which may have been trained for another row, that grown least."""
    if "block_densifications" in result.metrics:
        return int(result.metrics["block_densifications"])
    grown, blocks = times_grown(result.curve), _blocks(result)
    if blocks:  # the count is the sum of those begun, and goes up with each
        return max(0, grown - blocks)
    # a densification that removes more than it adds lowers the count
    return max(grown, int(result.counters.get("rows_added", 0) > 0))


def _blocks(result: Result) -> int:
    """How many blocks a scene was trained in; 0: in none."""
    return int(str(result.settings.get("blocks", 0)))


def _blocks_uncounted(result: Result) -> bool:
    """Whether a case's processor seconds are too few to have its blocks among them."""
    apart = result.stages.get("coarse", 0.0) + result.stages.get("blocks", 0.0)
    return bool(_blocks(result)) and result.cpu_seconds < COUNTED * apart


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    return {k: _rounded(v) for k, v in sorted(values.items()) if math.isfinite(v)}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
