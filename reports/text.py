"""Tables for the terminal, for Markdown, and cases for machines."""

import re
from collections.abc import Sequence

import rich.table
from rich.console import Group
from rich.text import Text

from splatproof.reference.types.result import Result
from splatproof.reports.columns import Column
from splatproof.reports.run_data import flatten
from splatproof.reports.table import Row, Table

LEGEND = (
    "± is half the 95 % confidence interval over seeds. Rows that the paired bootstrap over images "
    "and seeds cannot tell apart share a rank; bold is the best and what cannot be told from it. "
    "1 MB is 2²⁰ bytes."
)


def headings(table: Table) -> list[str]:
    """Headings of the columns that `texts` gives."""
    return ["rank", "method", *(column.heading for column in table.columns), "seeds"]


def explained(tables: list[Table]) -> dict[str, str]:
    """What each column of the tables is, by its heading, in the order of the tables."""
    columns = {column.heading: column.about for table in tables for column in table.columns}
    return columns | {"seeds": "finished runs that differ by their random draws alone"}


def texts(table: Table, row: Row) -> list[tuple[str, bool]]:
    """(text, whether it is marked best) of a row's cells, in the order of `headings`.

    Args:
        table: The table.
        row: One of its rows.
    """
    scores = [(_text(table, row, column), column.key in row.best) for column in table.columns]
    rank = "–" if row.rank is None else str(row.rank)
    return [(rank, False), (row.label, False), *scores, (str(row.seeds), False)]


def _text(table: Table, row: Row, column: Column) -> str:
    cell = row.cells.get(column.key)
    if cell is None:
        return "–"
    first = column == table.columns[0]
    return column.with_interval(cell) if first else column.text(cell.mean)


def notes(table: Table) -> list[str]:
    """What must be said beside the numbers: why rows are unranked, and every warning."""
    own = [f"{row.label}: {row.note}" for row in table.rows if row.note]
    return [*own, *variants(table), *(f"warning: {warning}" for warning in table.warnings)]


def variants(table: Table) -> list[str]:
    """A line for each row of a method that has several: the settings in which they differ.

    Args:
        table: Its rows; one whose seeds were run with several settings is left out.
    """
    rows: dict[str, list[tuple[str, dict[str, object]]]] = {}
    for row in table.rows:
        settings = [dict(flatten(result.settings)) for result in row.results]
        if settings and all(one == settings[0] for one in settings):
            rows.setdefault(row.results[0].method, []).append((row.label, settings[0]))
    lines = []
    for several in rows.values():
        names = list(dict.fromkeys(name for _, own in several for name in own))
        odd = [n for n in names if len({str(own.get(n)) for _, own in several}) > 1]
        for label, own in several if odd else ():
            # a label of unnamed rows says it already
            if any(f"{name}={own.get(name)}" not in label for name in odd):
                lines.append(f"{label}: " + ", ".join(f"{n} {own.get(n)}" for n in odd))
    return lines


def difference_lines(table: Table) -> list[str]:
    """Every pair of rows in the first column, with the interval and what it allows to say."""
    column = table.columns[0]
    unit = f" {column.unit}" if column.unit else ""
    lines = []
    for one, other, found in table.differences:
        if found.verdict == "unknown":
            continue
        numbers = f"{found.mean:+.{column.digits}f}{unit}"
        ends = f"[{found.low:+.{column.digits}f}, {found.high:+.{column.digits}f}]"
        over = f"{found.images} images" if found.images > 1 else "one image, so over seeds alone"
        lines.append(f"{one} − {other}: {numbers} {ends}, {found.verdict} ({over})")
    return lines


def terminal(tables: list[Table], width: int) -> Group:
    """Everything for a terminal, to be printed by rich.

    A table that is too wide goes on below, each part with rank and method: numbers never break.

    Args:
        tables: What `leaderboard.build_tables` makes.
        width: Characters a line.
    """
    parts: list[rich.table.Table | Text] = []
    for table in tables:
        title = Text(table.title, style="bold")
        for chosen in _parts(table, width):
            parts += [title, _part(table, chosen), Text()]
            title = Text(f"{table.title}, continued", style="bold")
        said = [
            Text(f"  {line}", style="dim") for line in (*notes(table), *difference_lines(table))
        ]
        parts += [*said, Text()] if said else []
    return Group(*parts, Text(LEGEND, style="dim"))


GAP = 2
"""Characters between columns."""


def _part(table: Table, chosen: list[int]) -> rich.table.Table:
    """The columns of these numbers."""
    shown = rich.table.Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    heads = _broken_headings(table)
    for i in chosen:
        shown.add_column(
            Text("\n".join(heads[i])), justify="left" if i == 1 else "right", no_wrap=True,
            vertical="bottom",
        )  # fmt: skip
    for row in table.rows:
        cells = texts(table, row)
        shown.add_row(*(Text(cells[i][0], style="bold" if cells[i][1] else "") for i in chosen))
    return shown


def _parts(table: Table, width: int) -> list[list[int]]:
    """Numbers of the columns of each part that fits into the width; all have rank and method."""
    rows = [[text for text, _ in texts(table, row)] for row in table.rows]
    sizes = [
        GAP + max(len(line) for line in (*head, *(row[i] for row in rows)))
        for i, head in enumerate(_broken_headings(table))
    ]
    parts, used = [[0, 1]], sum(sizes[:2])
    for i in range(2, len(sizes)):
        if used + sizes[i] - GAP > width and len(parts[-1]) > 2:
            parts.append([0, 1])
            used = sum(sizes[:2])
        parts[-1].append(i)
        used += sizes[i]
    return parts


def _broken_headings(table: Table) -> list[list[str]]:
    """Lines of every heading, broken at spaces and behind underscores to about the cells' width."""
    rows = [[text for text, _ in texts(table, row)] for row in table.rows]
    broken = []
    for i, heading in enumerate(headings(table)):
        # an arrow stays with what is before it
        pieces = re.findall(r"[^_ ]*_|[^_ ]+(?: [↑↓])? ?| ", heading)
        most = max([MIN_HEADING, *(len(row[i]) for row in rows)])
        lines = [""]
        for piece in pieces:
            if lines[-1] and len((lines[-1] + piece).rstrip()) > most:
                lines.append("")
            lines[-1] += piece
        broken.append([line.rstrip() for line in lines])
    return broken


MIN_HEADING = 8
"""Characters that a line of a heading may have however narrow its column's numbers are."""


def markdown(tables: list[Table]) -> str:
    """The leaderboard as a Markdown document."""
    blocks = ["# Leaderboard"]
    for table in tables:
        heads = headings(table)
        rules = ["---:" if i != 1 else ":---" for i in range(len(heads))]
        lines = [f"## {escaped(table.title)}", "", table_line(heads), table_line(rules)]
        for row in table.rows:
            cells = texts(table, row)
            lines.append(table_line([f"**{escaped(t)}**" if b else escaped(t) for t, b in cells]))
        said = [f"- {escaped(line)}" for line in (*notes(table), *difference_lines(table))]
        blocks.append("\n".join([*lines, "", *said]).rstrip())
    known = [f"- {escaped(name)}: {escaped(about)}" for name, about in explained(tables).items()]
    return "\n\n".join([*blocks, LEGEND, "\n".join(known)]) + "\n"


def table_line(cells: Sequence[str]) -> str:
    """A row of a Markdown table.

    Args:
        cells: Text that is Markdown already.
    """
    return f"| {' | '.join(cells)} |"


def escaped(text: str) -> str:
    """Text that Markdown shows as it is.

    Args:
        text: Any text; line breaks become spaces.
    """
    for mark in ("\\", "|", "*", "_", "<", "`"):
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())


def record(result: Result) -> dict[str, object]:
    """One case for a machine.

    Returns: suite, scene, method, variant, pose_noise, depth_prior, seed, protocol, every metric by
        its name, train_seconds, render_ms, primitives, bytes_on_disk, peak_memory_mb, settings, and
        error ("" when done).
    """
    return {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "pose_noise": result.pose_noise,
        "depth_prior": result.depth_prior,
        "seed": result.seed,
        "protocol": result.protocol,
        **result.metrics,
        "train_seconds": result.training_seconds,
        "render_ms": result.render_ms,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "peak_memory_mb": result.peak_memory_mb,
        "settings": result.settings,
        "error": result.error,
    }
