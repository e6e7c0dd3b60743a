"""How `bench run` answers a study: a line a row as it comes, a table at the end, a file in OUT."""

import json
import math
from pathlib import Path

from splatbench.cli import output
from splatbench.methods.files import write_text
from splatbench.suites.studies.study import STUDIES


def run_study(name: str, out: Path, *, quick: bool) -> int:
    """Print the rows of a study and write them to OUT/<name>.jsonl.

    Returns: 1 if a row says that it failed, else 0.
    """
    study = STUDIES[name]
    rows = []
    with output.progress() as bar:
        task = bar.add_task(name, total=None, values="")
        for row in study.rows(quick=quick):
            rows.append(row)
            bar.update(task, completed=len(rows), values=str(row.get("case", "")))
            if output.wants_json():
                output.print_record(row)
    failed = [row for row in rows if row.get("ok") is False]
    if not output.wants_json():
        _print_table(study.columns, rows)
    lines = [json.dumps(output.finite(row), ensure_ascii=False) + "\n" for row in rows]
    write_text(out / f"{name}.jsonl", "".join(lines))
    for row in failed:
        output.warn(f"{name}: {row} is over its budget")
    output.log(f"{len(rows)} rows, {len(failed)} over their budget; kept in {out / name}.jsonl")
    return int(bool(failed))


def _print_table(columns: tuple[str, ...], rows: list[dict]) -> None:
    """A table without wrapping; columns that are empty in every row are left out."""
    shown = [name for name in columns if any(_text(row.get(name)) for row in rows)]
    cells = [shown, *([_text(row.get(name)) for name in shown] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(shown))]
    for line in cells:
        output.print_text(
            "  ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)).rstrip()
        )


def _text(value: object) -> str:
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else str(value)
    return str(value)
