"""Leaderboards as plain data: what the list needs of each, and what the pages of its rows need besides."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from splatproof.reference.types.result import Result
from splatproof.reports import run_data
from splatproof.reports.columns import Column
from splatproof.reports.dashboard.numbers import plain_value, short
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.table import Row, Table

POINTS = 200
"""Points that are kept of a curve for the plots; the record has all."""


def digest(*parts: object) -> str:
    """Short hash that names something in links."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


def plain_tables(results: Sequence[Result], runs: Mapping[str, str]) -> list[dict[str, Any]]:
    """Every table of some results, as `leaderboard.build_tables` makes them.

    Args:
        results: Results under one protocol of one suite.
        runs: The run of each result by its `run_data.case_key`.
    Returns: Mappings with `brief`, for the list of all tables, and `full`, for the table's own file.
    """
    return [_plain(table, runs) for table in build_tables(results)]


def _plain(table: Table, runs: Mapping[str, str]) -> dict[str, Any]:
    # differences are named by the rows' places, since labels are long
    places = {row.label: place for place, row in enumerate(table.rows)}
    name = digest(table.suite, table.scene, table.protocol, run_data.digest(table.rules))
    brief = {
        "id": name,
        "suite": table.suite,
        "scene": table.scene,
        "protocol": table.protocol,
        "rules": run_data.digest(table.rules),
        "columns": [_column(column) for column in table.columns],
        "rows": [_row(row, table, runs) for row in table.rows],
        "warnings": list(table.warnings),
        "comparable": table.comparable,
    }
    full = {
        "rules": {name: plain_value(v) for name, v in run_data.flatten(table.rules)},
        "settings": _settings(table),
        "differences": [
            [places[one], places[other], short(d.mean), short(d.low), short(d.high), d.verdict,
             d.images, short(d.detectable)]
            for one, other, d in table.differences
        ],
        "curves": {} if not table.scene else {
            runs[run_data.case_key(result)]: thinned(result)
            for row in table.rows for result in row.results
        },
    }  # fmt: skip
    return {"brief": brief, "full": full}


def _column(column: Column) -> dict[str, Any]:
    return {
        "key": column.key,
        "title": column.title,
        "unit": column.unit,
        "better": column.higher_is_better,
        "digits": column.digits,
        "about": column.about,
        "images": column.per_image,
        "machine": column.of_the_machine,
    }


def row_side(suite: str, protocol: str, rules: str, label: str) -> str:
    """What a row, over all scenes of its suite, is called in links of the compare view.

    Args:
        suite: Name of the suite.
        protocol: Name of the protocol.
        rules: Hash of the protocol's rules.
        label: What tables call the row.
    """
    return digest("row", suite, protocol, rules, label)


def _row(row: Row, table: Table, runs: Mapping[str, str]) -> dict[str, Any]:
    suite, protocol, rules = table.suite, table.protocol, run_data.digest(table.rules)
    cells = {key: [short(c.mean), short(c.low), short(c.high)] for key, c in row.cells.items()}
    return {
        "label": row.label,
        "side": row_side(suite, protocol, rules, row.label),
        "rank": row.rank,
        "seeds": row.seeds,
        "note": row.note,
        "best": sorted(row.best),
        "cells": cells,
        "runs": [runs[run_data.case_key(result)] for result in row.results],
    }


def _settings(table: Table) -> dict[str, Any]:
    """Settings of every row's first case by name, and the names of those that are not the same in all."""
    own = {
        row.label: {name: plain_value(v) for name, v in run_data.flatten(row.results[0].settings)}
        for row in table.rows if row.results
    }  # fmt: skip
    names = sorted({name for values in own.values() for name in values})
    odd = [
        name for name in names
        if len({json.dumps(values.get(name, "not a setting")) for values in own.values()}) > 1
    ]  # fmt: skip
    return {"values": own, "odd": odd}


def thinned(result: Result) -> dict[str, Any]:
    """A result's curve as columns, of at most about POINTS points evenly taken, its ends among them.

    Args:
        result: Whose curve it is.
    Returns: `step`, `seconds` where the record has them, and every name with as many numbers; None where
        a point has no such value.
    """
    curve = result.curve
    step = max(1, -(-len(curve) // POINTS))
    places = list(range(0, len(curve), step))
    if curve and places[-1] != len(curve) - 1:
        places.append(len(curve) - 1)
    kept = [curve[place] for place in places]
    names = dict.fromkeys(name for _, values in kept for name in values)
    columns = {name: [short(values.get(name)) for _, values in kept] for name in names}
    if len(result.curve_seconds) == len(curve):
        columns["seconds"] = [short(result.curve_seconds[place]) for place in places]
    return {"step": [number for number, _ in kept]} | columns
