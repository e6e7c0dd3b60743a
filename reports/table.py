"""A leaderboard as data: what the terminal, Markdown and the page all show."""

from dataclasses import dataclass, field

import pandas as pd

from splatproof.reference.types.result import Result
from splatproof.reports.columns import Column
from splatproof.reports.statistics import Difference, Summary


@dataclass(frozen=True, kw_only=True)
class Row:
    """A method with its settings, over its seeds."""

    label: str
    """The method, with the settings that set it apart where the table has it more than once."""
    results: tuple[Result, ...]
    """Its finished cases, sorted by scene and seed."""
    scores: pd.DataFrame = field(compare=False, repr=False)
    """Rows of `results_frame` of these cases, sorted by scene, seed and image."""
    cells: dict[str, Summary]
    """Summary over seeds for each column's key; without an entry where there is no value."""
    seeds: int
    """Seeds behind every cell."""
    rank: int | None = None
    """1 + the number of ranked rows that are better beyond the interval; None: not ranked."""
    note: str = ""
    """Why it has no rank or no value, and what failed."""
    best: frozenset[str] = frozenset()
    """Columns in which no ranked row is better beyond the interval."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows that may stand under each other: one protocol, and one scene or the whole suite."""

    suite: str
    scene: str
    """Empty: the mean over the suite's scenes."""
    protocol: str
    rules: dict[str, object]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    """Ranked ones first, then by the mean of the first column."""
    differences: tuple[tuple[str, str, Difference], ...] = ()
    """(label, label, first minus second) in the first column, for every pair of rows."""
    warnings: tuple[str, ...]
    comparable: bool = True
    """Whether all rows were scored on the same truth; where not, none is ranked."""

    @property
    def title(self) -> str:
        """What it is about, e.g. "quick · town · ours_250"."""
        return " · ".join((self.suite, self.scene or "mean over scenes", self.protocol))
