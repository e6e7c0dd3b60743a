"""Ranks that seeds and images bear out: rows that cannot be told apart share one."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd

from splatproof.reports import comparable
from splatproof.reports.columns import Column
from splatproof.reports.frames import cases_of, groups
from splatproof.reports.statistics import Difference, Scores, paired_difference
from splatproof.reports.table import Row, Table


def ranked(table: Table, allowed: set[str]) -> Table:
    """The table with ranks, marks of the best, differences, and its rows in order.

    Args:
        table: Its rows in any order.
        allowed: Labels of the rows that may be ranked, should the table's rows be comparable.
    """
    may = allowed if table.comparable and table.columns[0].higher_is_better is not None else set()
    generator, main, read = np.random.default_rng(0), table.columns[0], Reader()
    sign = -1.0 if main.higher_is_better is False else 1.0

    def place(row: Row) -> tuple[bool, bool, float, str]:
        cell = row.cells.get(main.key)
        return row.label not in may, cell is None, -sign * cell.mean if cell else 0.0, row.label

    rows = sorted(table.rows, key=place)
    pairs = itertools.combinations([row for row in rows if main.key in row.cells], 2)
    found = [
        (one.label, other.label, difference(one, other, main, generator, read))
        for one, other in (pairs if table.comparable else ())
    ]
    better = {"higher": sign, "lower": -sign, "no difference": 0.0, "unknown": 0.0}
    worse = Counter(
        other if better[d.verdict] > 0 else one
        for one, other, d in found
        if better[d.verdict] and {one, other} <= may
    )
    best = _best(table, [row for row in rows if row.label in may], generator, read)
    done = [
        replace(
            row,
            rank=1 + worse[row.label] if row.label in may and main.key in row.cells else None,
            best=frozenset(key for key, labels in best.items() if row.label in labels),
        )
        for row in rows
    ]
    return replace(table, rows=tuple(done), differences=tuple(found))


def _best(
    table: Table, rows: list[Row], generator: np.random.Generator, read: "Reader"
) -> dict[str, set[str]]:
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
        verdicts = {r.label: difference(r, top, column, generator, read).verdict for r in having}
        best[column.key] = {r for r, verdict in verdicts.items() if verdict == "no difference"}
        best[column.key].add(top.label)
    return best


class Reader:
    """Scores of a table's rows, each read once: every row meets all others in every column."""

    def __init__(self) -> None:
        """Begin without any."""
        self._scenes: dict[str, dict[str, pd.DataFrame]] = {}
        self._cases: dict[tuple[str, str], pd.DataFrame] = {}
        self._scores: dict[tuple[str, str, str], Scores] = {}

    def scenes(self, row: Row) -> dict[str, pd.DataFrame]:
        """The row's scores by scene, by the scenes' names."""
        if row.label not in self._scenes:
            self._scenes[row.label] = dict(groups(row.scores, "scene"))
        return self._scenes[row.label]

    def cases(self, row: Row, scene: str) -> pd.DataFrame:
        """The first row of each of the row's cases in a scene: one a seed.

        Args:
            row: A row of the table.
            scene: One of its scenes.
        """
        key = (row.label, scene)
        if key not in self._cases:
            self._cases[key] = cases_of(self.scenes(row)[scene])
        return self._cases[key]

    def scores(self, row: Row, scene: str, column: Column) -> Scores:
        """A row a seed and a column an image, sorted by name; one column where images have no values.

        Args:
            row: A row of the table.
            scene: One of its scenes.
            column: One of the table's columns.
        """
        key = (row.label, scene, column.key)
        if key not in self._scores:
            own = self.scenes(row)[scene]
            cases = self.cases(row, scene)
            self._scores[key] = (
                own[column.key].to_numpy(dtype=np.float64).reshape(len(cases), -1)
                if column.per_image
                else column.values(cases)[:, None]
            )
        return self._scores[key]


def difference(
    one: Row, other: Row, column: Column, generator: np.random.Generator, read: Reader
) -> Difference:
    """Paired difference of two rows in a column, over scenes, images (where it has them), seeds.

    Args:
        one: A row of a table whose rows are comparable.
        other: Another row of it.
        column: What is compared.
        generator: Source of the bootstrap's draws.
        read: What was read of the table's rows before.
    """
    pairs = [
        (read.scores(one, scene, column), read.scores(other, scene, column))
        for scene in read.scenes(one)
    ]
    return paired_difference(pairs, generator)
