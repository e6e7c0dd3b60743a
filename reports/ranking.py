"""Ranks that seeds and images bear out: rows that cannot be told apart share one."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd

from splatproof.reports import comparable
from splatproof.reports.columns import Column
from splatproof.reports.frames import cases_of, rows_where
from splatproof.reports.statistics import Difference, Scores, paired_difference
from splatproof.reports.table import Row, Table


def ranked(table: Table, allowed: set[str]) -> Table:
    """The table with ranks, marks of the best, differences, and its rows in order.

    Args:
        table: Its rows in any order.
        allowed: Labels of the rows that may be ranked, should the table's rows be comparable.
    """
    may = allowed if table.comparable and table.columns[0].higher_is_better is not None else set()
    generator, main = np.random.default_rng(0), table.columns[0]
    sign = -1.0 if main.higher_is_better is False else 1.0

    def place(row: Row) -> tuple[bool, bool, float, str]:
        cell = row.cells.get(main.key)
        return row.label not in may, cell is None, -sign * cell.mean if cell else 0.0, row.label

    rows = sorted(table.rows, key=place)
    pairs = itertools.combinations([row for row in rows if main.key in row.cells], 2)
    found = [
        (one.label, other.label, difference(one, other, main, generator))
        for one, other in (pairs if table.comparable else ())
    ]
    better = {"higher": sign, "lower": -sign, "no difference": 0.0, "unknown": 0.0}
    worse = Counter(
        other if better[d.verdict] > 0 else one
        for one, other, d in found
        if better[d.verdict] and {one, other} <= may
    )
    best = _best(table, [row for row in rows if row.label in may], generator)
    done = [
        replace(
            row,
            rank=1 + worse[row.label] if row.label in may and main.key in row.cells else None,
            best=frozenset(key for key, labels in best.items() if row.label in labels),
        )
        for row in rows
    ]
    return replace(table, rows=tuple(done), differences=tuple(found))


def _best(table: Table, rows: list[Row], generator: np.random.Generator) -> dict[str, set[str]]:
    """Labels by column of the best ranked row and of those that cannot be told from it."""
    best = {}
    one_machine = not rows or not comparable.environment_notes(
        pd.concat([row.scores for row in rows])
    )
    for column in table.columns:
        having = [row for row in rows if column.key in row.cells]
        if column.higher_is_better is None or len(having) < 2:
            continue
        if column.of_the_machine and not one_machine:
            continue
        sign = 1.0 if column.higher_is_better else -1.0
        top = max(having, key=lambda row: sign * row.cells[column.key].mean)
        verdicts = {r.label: difference(r, top, column, generator).verdict for r in having}
        best[column.key] = {r for r, verdict in verdicts.items() if verdict == "no difference"}
        best[column.key].add(top.label)
    return best


def difference(one: Row, other: Row, column: Column, generator: np.random.Generator) -> Difference:
    """Paired difference of two rows in a column, over scenes, images (where it has them), seeds.

    Args:
        one: A row of a table whose rows are comparable.
        other: Another row of it.
        column: What is compared.
        generator: Source of the bootstrap's draws.
    """
    scenes = sorted(set(one.scores["scene"]))
    tables = [tuple(_scores(row, scene, column) for row in (one, other)) for scene in scenes]
    return paired_difference([(a, b) for a, b in tables], generator)


def _scores(row: Row, scene: str, column: Column) -> Scores:
    """A row a seed and a column an image, sorted by name; one column where images have no values."""
    own = rows_where(row.scores, (row.scores["scene"] == scene).to_numpy())
    cases = cases_of(own)
    if not column.per_image:
        return column.values(cases)[:, None]
    return own[column.key].to_numpy(dtype=np.float64).reshape(len(cases), -1)
