"""Tables for the terminal, for Markdown, and cases for machines."""

import rich.table
from rich.console import Group
from rich.text import Text

from splatbench.reference.result import Result
from splatbench.reports.columns import Column
from splatbench.reports.table import Row, Table

LEGEND = (
    "± is half the 95 % confidence interval over seeds. Rows that the paired bootstrap over images "
    "and seeds cannot tell apart share a rank; bold is the best and what cannot be told from it. "
    "1 MB is 2²⁰ bytes."
)


def headings(table: Table) -> list[str]:
    """Headings of the columns that `texts` gives."""
    return ["rank", "method", *(column.heading for column in table.columns), "seeds"]


def texts(table: Table, row: Row) -> list[tuple[str, bool]]:
    """(text, whether it is marked best) of a row's cells, in the order of `headings`."""
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
    return [*own, *(f"warning: {warning}" for warning in table.warnings)]


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


def terminal(tables: list[Table]) -> Group:
    """Everything for a terminal, to be printed by rich."""
    parts: list[rich.table.Table | Text] = []
    for table in tables:
        shown = rich.table.Table(
            title=Text(table.title), title_justify="left", title_style="bold", box=None, pad_edge=False
        )  # fmt: skip
        for i, heading in enumerate(headings(table)):
            shown.add_column(Text(heading), justify="left" if i == 1 else "right")
        for row in table.rows:
            shown.add_row(*(Text(t, style="bold" if b else "") for t, b in texts(table, row)))
        lines = [*notes(table), *difference_lines(table)]
        parts += [shown, *(Text(f"  {line}", style="dim") for line in lines), Text()]
    return Group(*parts, Text(LEGEND, style="dim"))


def markdown(tables: list[Table]) -> str:
    """The leaderboard as a Markdown document."""
    blocks = ["# Leaderboard"]
    for table in tables:
        heads = headings(table)
        rules = ["---:" if i != 1 else ":---" for i in range(len(heads))]
        lines = [f"## {_escaped(table.title)}", "", _line(heads), _line(rules)]
        for row in table.rows:
            cells = texts(table, row)
            lines.append(_line([f"**{_escaped(t)}**" if b else _escaped(t) for t, b in cells]))
        said = [f"- {_escaped(line)}" for line in (*notes(table), *difference_lines(table))]
        blocks.append("\n".join([*lines, "", *said]).rstrip())
    return "\n\n".join([*blocks, LEGEND]) + "\n"


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    for mark in ("\\", "|", "*", "_", "<", "`"):
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())


def record(result: Result) -> dict[str, object]:
    """One case for a machine.

    Returns: suite, scene, method, seed, protocol, every metric by its name, train_seconds,
        render_ms, primitives, bytes_on_disk, peak_memory_mb, settings, and error ("" when done).
    """
    return {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "seed": result.seed,
        "protocol": result.protocol,
        **result.metrics,
        "train_seconds": result.stages.get("train"),
        "render_ms": result.render_ms,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "peak_memory_mb": result.peak_memory_mb,
        "settings": result.settings,
        "error": result.error,
    }
