"""The effect that a paper prints, computed from the cells of its tables and never typed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean

from splatproof.base.errors import UsageError

Numbers = Sequence[Mapping[str, str]]
"""Published values: columns paper, table, method, variant, dataset, scene, metric, value, note."""
Cell = dict[str, str]
"""What the columns of the cells that are meant hold."""
COLUMNS = ("method", "variant", "dataset", "scene")
"""Columns that a cell may name."""
SUSPECT = "extraction suspect"
"""How the note of a value begins that is not to be compared with anything."""


@dataclass(frozen=True, kw_only=True)
class Cells:
    """The cells of a paper's tables that an effect is the difference or ratio of.

    Where several scenes fit they are paired, and the effect is that of the means over scenes.
    """

    tables: tuple[str, ...]
    """Tables that hold them: scenes of one comparison may be printed in two."""
    metric: str
    """As printed; frames a second of a claim about times are taken as seconds a frame."""
    row: Cell
    """Columns of the cells of the claim's row."""
    other: Cell = field(default_factory=dict)
    """The same of the other row; empty: the cell is itself a difference."""


def effect_of(
    paper: str, cells: Cells, relative: bool, per_second: bool, numbers: Numbers, where: str
) -> float:
    """The printed row - other, or row / other - 1.

    Args:
        paper: As in the numbers.
        cells: Which values.
        relative: Whether the effect is a ratio.
        per_second: Whether the printed values are rates of what is claimed.
        numbers: All published values.
        where: File and claim, for errors.
    Raises: UsageError where no value or more than one fits a place, where the rows are printed for
        other scenes, or where a value is suspect.
    """
    row, other = sides(paper, cells, numbers, where)
    mean = fmean(row.values())
    if not other:
        return mean
    pair = (mean, fmean(other.values()))
    if per_second and cells.metric == "fps":
        pair = (1 / pair[0], 1 / pair[1])
    return pair[0] / pair[1] - 1 if relative else pair[0] - pair[1]


def source_of(paper: str, cells: Cells, numbers: Numbers, where: str) -> str:
    """Table and printed cells in words: "table 3: psnr 29.74, 28.11"; a mean says over how many scenes.

    Args:
        paper: As in the numbers.
        cells: Which values.
        numbers: All published values.
        where: File and claim, for errors.
    """
    row, other = sides(paper, cells, numbers, where)
    name = f"table{'s' if len(cells.tables) > 1 else ''} {', '.join(cells.tables)}"
    digits = 4 if len(row) > 1 else 6  # printed values as they are, means as far as it matters
    means = ", ".join(f"{fmean(side.values()):.{digits}g}" for side in (row, other) if side)
    over = f", means of {len(row)} scenes" if len(row) > 1 else ""
    return f"{name}: {cells.metric} {means}{over}"


Sides = tuple[dict[tuple[str, str], float], dict[tuple[str, str], float]]


def sides(paper: str, cells: Cells, numbers: Numbers, where: str) -> Sides:
    """Printed values of both rows by (data set, scene).

    Args:
        paper: As in the numbers.
        cells: Which values.
        numbers: All published values.
        where: File and claim, for errors.

    Raises: UsageError, see `effect_of`.
    """
    row = _values(paper, cells, cells.row, numbers, where)
    other = _values(paper, cells, cells.other, numbers, where) if cells.other else {}
    named = [{"dataset", "scene"} & side.keys() for side in (cells.row, cells.other)]
    if other and not any(named) and row.keys() != other.keys():
        raise UsageError(f"{where}: the rows are printed for other scenes: {[*row]} and {[*other]}")
    return row, other


def _values(
    paper: str, cells: Cells, wanted: Cell, numbers: Numbers, where: str
) -> dict[tuple[str, str], float]:
    if odd := sorted(wanted.keys() - set(COLUMNS)):
        raise UsageError(f"{where}: cells name column {odd[0]!r}; there are {', '.join(COLUMNS)}")
    found: dict[tuple[str, str], float] = {}
    for line in numbers:
        if (line["paper"], line["metric"]) != (paper, cells.metric):
            continue
        if line["table"] not in cells.tables or any(line[k] != v for k, v in wanted.items()):
            continue
        place = (line["dataset"], line["scene"])
        if place in found:
            raise UsageError(f"{where}: two values of {wanted} are printed for {place}")
        if line["note"].startswith(SUSPECT):
            raise UsageError(f"{where}: {wanted} is an {SUSPECT}: {line['note']}")
        found[place] = float(line["value"])
    if not found:
        raise UsageError(
            f"{where}: no {cells.metric} of {wanted} in {paper}, table {', '.join(cells.tables)}"
        )
    return found
