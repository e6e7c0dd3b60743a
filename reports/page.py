"""The report page: one HTML file that needs nothing but itself."""

import datetime
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup

from splatproof.reference.types.result import MOMENTS, Result
from splatproof.reports import charts, run_data, text
from splatproof.reports.columns import Column
from splatproof.reports.frames import groups
from splatproof.reports.mlflow_client import shown_uri
from splatproof.reports.pictures import QUALITY, WIDEST, Shown, choose
from splatproof.reports.store import StoredResult
from splatproof.reports.table import Row, Table

PICTURE_BUDGET = 24_000_000
"""Characters of embedded pictures in a page, shared evenly by its scenes; one image each at least."""
OPEN_DIFFERENCES = 15
"""Pairs of rows whose verdicts are open when the page is: all pairs of six rows."""


def render_page(
    tables: Sequence[Table],
    stored: Sequence[StoredResult],
    uri: str,
    when: datetime.datetime,
    budget: int = PICTURE_BUDGET,
) -> str:
    """The page as HTML: leaderboards, pictures, per-image tables, curves, and how it was made.

    Args:
        tables: What `leaderboard.build_tables` makes of the results of `stored`.
        stored: What was read from the store; the pictures come from there.
        uri: Where it was read from; shown without a password.
        when: Shown as the time of making.
        budget: Characters of embedded pictures. Where the test images need more, each scene shows
            the worst, the best and those between that fit, and says how many it left out.
    Raises: DataError where a stored picture is damaged.
    """
    by_case = {run_data.case_key(one.result): one for one in stored}
    scenes = [table for table in tables if table.scene]
    pictures: dict[str, str] = {}
    views = []
    for number, table in enumerate(tables):
        shown, images = [], 0
        if table.scene:
            shown, images = choose(table, by_case, budget // len(scenes))
        views.append(_view(number, table, shown, images, pictures))
    results = [one.result for one in stored]
    folder = Path(__file__).parent / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2").render(
        views=views,
        legend=text.LEGEND,
        columns=text.explained(list(tables)),
        counts=_counts(results),
        when=when.strftime("%Y-%m-%d %H:%M"),
        uri=shown_uri(uri),
        style=Markup((folder / "page.css").read_text("utf-8")),
        script=Markup((folder / "page.js").read_text("utf-8")),
        pictures=pictures,
        environments=_environments(results),
        protocols={run_data.digest(t.rules): (t.protocol, _plain(t.rules)) for t in tables},
        widest=WIDEST,
        quality=QUALITY,
        open_differences=OPEN_DIFFERENCES,
    )


def _view(
    number: int, table: Table, shown: list[Shown], images: int, pictures: dict[str, str]
) -> dict[str, Any]:
    """What the template shows of a table; its pictures are added to `pictures`, each once."""
    series = {row.label: i for i, row in enumerate(sorted(table.rows, key=lambda r: r.label))}
    finished = [row for row in table.rows if row.results]
    known = text.explained([table])
    return {
        "id": f"t{number}",
        "table": table,
        "headings": [(_heading(h), known.get(h, "")) for h in text.headings(table)],
        "cells": [(row, series[row.label], text.texts(table, row)) for row in table.rows],
        "swatches": {label: charts.swatch(i) for label, i in series.items()},
        "notes": [
            *(f"{row.label}: {row.note}" for row in table.rows if row.note),
            *text.variants(table),
        ],
        "differences": text.difference_lines(table),
        "compare": _compare(shown, finished, pictures),
        "embedded": len(shown),
        "images": images,
        "image_tables": [_image_table(table, row) for row in finished] if table.scene else [],
        "curves": _curves(finished, series) if table.scene else [],
        "scatters": _scatters(table, series),
        "facts": _facts(table),
        "left_out": sorted({photo for row in finished for r in row.results for photo in r.left_out})
        if table.scene
        else [],
    }


def _heading(heading: str) -> Markup:
    """A heading that may break at underscores but not before its arrow."""
    for arrow in "↑↓":
        heading = heading.replace(f" {arrow}", f"\u00a0{arrow}")
    return Markup("_<wbr>").join(heading.split("_"))


def _compare(shown: list[Shown], rows: list[Row], pictures: dict[str, str]) -> dict[str, Any]:
    """Names of the images and rows, and for each pair the keys of its three pictures."""
    numbers = {uri: key for key, uri in pictures.items()}

    def key(uri: str | None) -> str | None:
        if uri is None:
            return None
        if uri not in numbers:
            numbers[uri] = f"p{len(numbers)}"
            pictures[numbers[uri]] = uri
        return numbers[uri]

    labels = [row.label for row in rows if any(row.label in image.render for image in shown)]
    return {
        "images": [image.name for image in shown],
        "rows": labels,
        "seeds": {row.label: row.results[0].seed for row in rows},
        "pictures": {
            image.name: {
                label: [key(kind.get(label)) for kind in (image.truth, image.render, image.error)]
                for label in labels
            }
            for image in shown
        },
    }


def _image_table(table: Table, row: Row) -> dict[str, Any]:
    """Scores of every image, means over seeds, and their span in the first column."""
    columns = [column for column in table.columns if column.per_image]
    lines = []
    for name, seeds in groups(row.scores, "image"):
        means = [(float(seeds[c.key].to_numpy().mean()), c) for c in columns]
        told = [f"{c.title} {c.text(mean)} {c.unit}".strip() for mean, c in means]
        lines.append(
            {
                "name": name,
                "told": " · ".join(told),
                "cells": [(mean, c.text(mean)) for mean, c in means],
                "span": _span(columns[0], seeds) if columns else (math.nan, "–"),
                "valid": 100 * float(seeds["valid_share"].to_numpy().mean()),
            }
        )
    return {"label": row.label, "seeds": row.seeds, "columns": columns, "lines": lines}


def _span(column: Column, seeds: pd.DataFrame) -> tuple[float, str]:
    """How far the seeds' scores of an image are apart; a dash where one is not finite."""
    values = seeds[column.key].to_numpy(dtype=np.float64)
    if not np.isfinite(values).all():
        return math.nan, "–"
    return float(np.ptp(values)), column.text(float(np.ptp(values)))


def _curves(rows: list[Row], series: dict[str, int]) -> list[tuple[str, Markup]]:
    """A chart for everything that was logged while training, a line a seed."""
    names = {name: None for row in rows for r in row.results for _, v in r.curve for name in v}
    drawn = []
    for name in names:
        curves = [
            charts.Line(
                f"{row.label} seed {result.seed}",
                series[row.label],
                [(float(step), values[name]) for step, values in result.curve if name in values],
            )
            for row in rows
            for result in row.results
        ]
        drawn.append((name, charts.lines(curves, "step", name)))
    return [(name, chart) for name, chart in drawn if chart]


def _scatters(table: Table, series: dict[str, int]) -> list[Markup]:
    """The first column against the time to render and to train."""
    main = table.columns[0]
    y_title = f"{main.title} [{main.unit}]" if main.unit else main.title
    drawn = []
    for cost in ("render_ms", "train_seconds"):
        column = next(c for c in table.columns if c.key == cost)
        points = [
            charts.Point(
                row.label,
                series[row.label],
                row.cells[cost].mean,
                row.cells[main.key].mean,
                row.cells[main.key].low,
                row.cells[main.key].high,
            )
            for row in table.rows
            if cost in row.cells and main.key in row.cells
        ]
        if len(points) > 1:  # one point is no comparison; its numbers stand in the table
            drawn.append(charts.scatter(points, f"{column.title} [{column.unit}]", y_title))
    return [chart for chart in drawn if chart]


def _facts(table: Table) -> dict[str, str]:
    """Facts of the scene that all its results agree on."""
    if not table.scene:
        return {}
    facts = [result.scene_facts for row in table.rows for result in row.results]
    return {
        name: value
        for name, value in (facts[0] if facts else {}).items()
        if all(other.get(name) == value for other in facts)
    }


def _counts(results: Sequence[Result]) -> list[tuple[int, str]]:
    """How many of each thing the page shows."""
    counted = {
        "case": len(results),
        "scene": len({result.scene for result in results}),
        "method": len({result.row for result in results}),
        "protocol": len({result.protocol for result in results}),
        "failed case": sum(bool(result.error) for result in results),
    }
    return [(n, name + ("" if n == 1 else "s")) for name, n in counted.items() if n]


def _environments(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Every environment that cases were measured in, with the cases' number."""
    groups: dict[str, dict[str, Any]] = {}
    for result in results:
        values = {k: v for k, v in result.environment.items() if k not in MOMENTS}
        group = groups.setdefault(run_data.digest(values), {"values": values, "cases": 0})
        group["cases"] += 1
    return list(groups.values())


def _plain(rules: dict[str, object]) -> dict[str, str]:
    """Rules as text; long lists are cut with their length."""
    shown = {}
    for name, value in run_data.flatten(rules):
        line = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
        shown[name] = line if len(line) <= 200 else f"{line[:200]}… ({len(line)} characters)"
    return shown
