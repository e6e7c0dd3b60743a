"""The two files that lists are made of: all runs and tables, and the scores of all images."""

import json
from collections.abc import Callable, Sequence
from typing import Any

from splatproof.reports.dashboard.history import series_id
from splatproof.reports.dashboard.index import Index
from splatproof.reports.dashboard.numbers import short
from splatproof.reports.dashboard.summary import Summary

TEXTS: dict[str, Callable[[Summary], str]] = {
    "suite": lambda one: one.suite,
    "scene": lambda one: one.numbers.scene,
    "row": lambda one: one.numbers.row,
    "protocol": lambda one: one.numbers.protocol,
    "commit": lambda one: one.commit,
    "settings": lambda one: one.settings,
    "rules": lambda one: one.rules,
    "environment": lambda one: one.environment,
    "machine": lambda one: one.numbers.machine,
    "data": lambda one: one.numbers.data,
    "error": lambda one: one.numbers.error,
    "series": lambda one: series_id(one.series),
}
"""What of a run is text; few different ones stand for many runs, so the page gets numbers for them."""


def runs_payload(index: Index) -> dict[str, Any]:
    """Every run as columns, and every leaderboard.

    Args:
        index: The store.
    Returns: `texts`: for each name of TEXTS its different values and the place of each run's; `run`,
        `seed`, `ended`, `steps`, `images`: a value a run; `values`: numbers by name; `newest`: places of
        the runs that stand in leaderboards; `columns`: the different columns of tables; `tables`, with
        places for their columns and their rows' runs.
    """
    runs = index.runs
    names = sorted({name for one in runs for name in one.numbers.values})
    shown = {one.run for one in index.shown}
    columns, tables = _shared(index)
    return {
        "run": [one.run for one in runs],
        "seed": [one.numbers.seed for one in runs],
        "ended": [one.ended for one in runs],
        "steps": [one.numbers.steps for one in runs],
        "images": [len(one.numbers.images) for one in runs],
        "texts": {name: _coded([of(one) for one in runs]) for name, of in TEXTS.items()},
        "values": {name: [short(one.numbers.values.get(name)) for one in runs] for name in names},
        "newest": [place for place, one in enumerate(runs) if one.run in shown],
        "columns": columns,
        "tables": tables,
    }


def _shared(index: Index) -> tuple[list[Any], list[Any]]:
    """The different columns of all tables, and the tables with places for their columns and runs.

    Ten thousand results then take half the bytes, which the page has to read before it shows a list.
    """
    places = {one.run: place for place, one in enumerate(index.runs)}
    columns: dict[str, tuple[int, Any]] = {}
    tables = []
    for brief in (table["brief"] for table in index.tables):
        named = [json.dumps(column) for column in brief["columns"]]
        for name, column in zip(named, brief["columns"], strict=True):
            columns.setdefault(name, (len(columns), column))
        rows = [row | {"runs": [places[run] for run in row["runs"]]} for row in brief["rows"]]
        tables.append(brief | {"columns": [columns[name][0] for name in named], "rows": rows})
    return [column for _, column in columns.values()], tables


def _coded(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Texts as their different values, sorted, and the place of each among them."""
    known = sorted(set(texts))
    places = {text: place for place, text in enumerate(known)}
    return {"known": known, "of": [places[text] for text in texts]}


def images_payload(index: Index) -> dict[str, Any]:
    """Scores of every image of the newest run of every case.

    Args:
        index: The store.
    Returns: `lists`: the different lists of image names; `run`: the runs; `list`: the place of each
        one's list; `values`: for each metric the scores of all images of all runs, one after the other;
        None where an image has none.
    """
    lists: dict[tuple[str, ...], int] = {}
    own = [one for one in index.shown if one.numbers.images]
    places = [lists.setdefault(tuple(one.numbers.images), len(lists)) for one in own]
    scored = [image for one in own for image in one.numbers.images.values()]
    names = sorted({name for image in scored for name in image})
    return {
        "lists": [list(names) for names in lists],
        "run": [one.run for one in own],
        "list": places,
        "values": {name: [short(image.get(name)) for image in scored] for name in names},
    }
