"""A paper's printed rows beside ours: the same order, or not."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from splatproof.reports.measured import Measured
from splatproof.reports.verdicts import untimed_among
from splatproof.suites.published.rows import numbers

OURS = {"storage_mb": "disk_mb", "fps": "fps", "psnr": "psnr", "ssim": "ssim_3dgs",
        "absrel": "depth_abs_rel", "delta1": "depth_delta1", "gpu_hours": "train_seconds"}  # fmt: skip
"""What we call a printed metric."""
SECONDS = {"fps": "render_ms", "gpu_hours": "train_seconds"}
"""The time that we measured behind a printed one."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A printed row and ours."""

    method: str
    """As in numbers.csv."""
    row: str
    """Ours."""
    variant: str = ""
    """What the printed variant must be, or contain where it ends in "*"."""


@dataclass(frozen=True, kw_only=True)
class Printed:
    """A table of a paper, or a part of one."""

    paper: str
    table: str
    title: str
    lines: tuple[Line, ...]
    metrics: tuple[str, ...]
    """As in numbers.csv, keys of OURS."""
    dataset: str = ""
    """As in numbers.csv."""
    without: str = ""
    """What no variant that is meant contains; empty: nothing is left out."""
    protocol: str = ""
    """Protocol of our rows; empty: any."""


def printed_tables(tables: Sequence[Printed], rows: Sequence[Measured]) -> list[str]:
    """Markdown of each table; nothing where there is none.

    Args:
        tables: What is shown.
        rows: All our cases.
    """
    if not tables:
        return []
    return ["## Headline tables, printed and here\n", NOTE, *(_table(one, rows) for one in tables)]


NOTE = """Printed numbers are of other scenes, resolutions and lengths (`bench published` says what differs): the order of
rows is compared, not their values.
"""


def _table(table: Printed, rows: Sequence[Measured]) -> str:
    alike = on_common_scenes(table, rows)
    heads = [f"{metric} {where}" for metric in table.metrics for where in ("printed", "here")]
    lines = [f"### {table.paper}, table {table.table}: {table.title}\n",
             "| printed row | ours | " + " | ".join(heads) + " |",
             "|---|---" + "|---:" * len(heads) + "|"]  # fmt: skip
    values = {
        (line, metric): (printed_value(table, line, metric), ours(table, line, metric, alike))
        for line in table.lines for metric in table.metrics
    }  # fmt: skip
    for line in table.lines:
        cells = [_text(v) for metric in table.metrics for v in values[line, metric]]
        name = f"{line.method} {line.variant.rstrip('*')}".strip()
        lines.append(f"| {name} | `{line.row}` | " + " | ".join(cells) + " |")
    agreed = [
        busy(table, metric, alike) or _agreement(metric, [values[line, metric] for line in table.lines])
        for metric in table.metrics
    ]  # fmt: skip
    scenes = ", ".join(dict.fromkeys(run.scene for run in alike))
    means = f"Here: mean over {scenes}. " if scenes else ""
    return (
        "\n".join(lines) + f"\n\n{means}Pairs of rows in the printed order: {'; '.join(agreed)}.\n"
    )


def printed_value(table: Printed, line: Line, metric: str) -> float:
    """Mean over the scenes of a table for which the value is printed; nan where it is not.

    Args:
        table: The table.
        line: One of its rows.
        metric: As in numbers.csv.
    """
    found = [
        float(one["value"])
        for one in numbers()
        if (one["paper"], one["table"], one["method"], one["metric"])
        == (table.paper, table.table, line.method, metric)
        and table.dataset in ("", one["dataset"])
        and not (table.without and table.without in one["variant"])
        and (
            line.variant.rstrip("*") in one["variant"]
            if line.variant.endswith("*")
            else one["variant"] == line.variant
        )
    ]
    return fmean(found) if found else math.nan


def on_common_scenes(table: Printed, rows: Sequence[Measured]) -> list[Measured]:
    """Our cases of the scenes that all lines have which have been run: means over others do not compare.

    Args:
        table: The table; its protocol counts.
        rows: All our cases.
    """
    done = [r for r in rows if not r.error and table.protocol in ("", r.protocol)]
    scenes = [{r.scene for r in done if r.row == line.row} for line in table.lines]
    common = set.intersection(*(own for own in scenes if own)) if any(scenes) else set()
    return [r for r in done if r.scene in common]


def ours(table: Printed, line: Line, metric: str, rows: Sequence[Measured]) -> float:
    """Our mean over scenes and seeds; nan where the row has not been run.

    Args:
        table: The table; its protocol counts.
        line: One of its rows.
        metric: As in numbers.csv.
        rows: All our cases.
    """
    own = [r.values for r in rows if r.row == line.row and not r.error
           and table.protocol in ("", r.protocol)]  # fmt: skip
    if metric == "fps":
        found = [1000 / v["render_ms"] for v in own if v.get("render_ms")]
    else:
        unit = 3600 if metric == "gpu_hours" else 1
        found = [v[OURS[metric]] / unit for v in own if OURS[metric] in v]
    return fmean(found) if found else math.nan


def busy(table: Printed, metric: str, rows: Sequence[Measured]) -> str:
    """That the order of rows by a time says nothing, in the words of the claims; empty where it does.

    Args:
        table: Its lines count.
        metric: As in numbers.csv.
        rows: Our cases that are compared.
    """
    named = {line.row for line in table.lines}
    own = [run for run in rows if run.row in named]
    why = untimed_among(SECONDS[metric], own) if metric in SECONDS else ""
    return f"{metric} not testable here ({why})" if why else ""


def _agreement(metric: str, pairs: Sequence[tuple[float, float]]) -> str:
    known = [pair for pair in pairs if not any(map(math.isnan, pair))]
    compared = [(a, b) for a, b in itertools.combinations(known, 2) if a[0] != b[0]]
    same = sum((a[0] > b[0]) == (a[1] > b[1]) for a, b in compared)
    return f"{metric} {same} of {len(compared)}"


def _text(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:,.4g}"
