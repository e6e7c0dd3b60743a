"""How `bench run` answers a study: a line a row as it comes, a table at the end, files in OUT."""

import json
import math
import os
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.files import write_text
from splatproof.cli import output
from splatproof.methods.backends import get_backend
from splatproof.suites.studies.study import STUDIES, Study

Row = dict[str, Any]


def run_study(
    name: str,
    out: Path,
    *,
    quick: bool,
    wait: float = 300.0,
    backend: str = "cpu",
    page: Path | None = None,
    recorded: Path | None = None,
) -> int:
    """Print the rows of a study, write OUT/<name>.jsonl, and what else the study has.

    Args:
        name: Of the study.
        out: Folder for rows and pictures.
        quick: Reduced form.
        wait: Seconds that may be lost to other processes, for studies that wait.
        backend: Whose twins are compared, for studies that compare some.
        page: Write the study's page to this file.
        recorded: Make the page of the rows in this file and measure nothing.

    Returns: 1 if a row says that it failed, else 0.
    Raises: UsageError for an option that this study does not have; DataError if the file that rows
        are read from is none.
    """
    study = STUDIES[name]
    if page is not None and study.page is None:
        raise UsageError(f"--page is for studies that have a page, {name} has none")
    if not 0 <= wait < math.inf:
        raise UsageError(f"--wait is {wait}, expected seconds, 0 or more")
    if recorded is not None:
        if page is None:
            raise UsageError("--rows is for making a page again: give --page too")
        machine, rows = read_rows(recorded)
        write_page(study, machine, rows, page)
        return 0
    machine = _machine(study, backend)
    file = out / f"{name}.jsonl"
    rows = _measure(name, study, quick, {"wait": wait, "backend": backend}, file)
    if not output.wants_json():
        _print_table(study.columns, rows)
    failed = [row for row in rows if row.get("ok") is False]
    for row in failed:
        output.warn(f"{name}: {row} is over its budget")
    output.log(f"{len(rows)} rows, {len(failed)} over their budget; kept in {file}")
    drawn = study.pictures(rows, out / name) if study.pictures else []
    for path in drawn:
        output.log(f"drawn: {path}")
    if page is not None:
        write_page(study, machine, rows, page)
    if study.logged:
        _log(name, out, machine, rows, [file, *drawn])
    return int(bool(failed))


def _measure(name: str, study: Study, quick: bool, given: dict[str, Any], file: Path) -> list[Row]:
    """All rows, told and kept in the file as they come: a kill loses only what is being measured."""
    options = {option: given[option] for option in study.options}
    if "backend" in study.options:
        get_backend(given["backend"])
    rows: list[Row] = []
    write_text(file, "")
    try:
        with output.progress() as bar:
            task = bar.add_task(name, total=None, values="")
            for row in study.rows(quick=quick, **options):
                rows.append(row)
                lines = (
                    json.dumps(output.finite(held), ensure_ascii=False) + "\n" for held in rows
                )
                write_text(file, "".join(lines))
                bar.update(task, completed=len(rows), values=str(row.get("case", "")))
                if output.wants_json():
                    output.print_record(row)
    except KeyboardInterrupt:  # rows are measured side by side: nothing to go on from
        output.warn(
            f"interrupted: {len(rows)} rows are kept in {file}; the same command starts over"
        )
        raise SystemExit(130) from None
    return rows


def _machine(study: Study, backend: str) -> dict[str, str]:
    """Where the rows are measured, for studies that say it."""
    if study.page is None and not study.logged:
        return {}
    from splatproof.suites.environment import machine

    return machine(backend)


def read_rows(path: Path) -> tuple[dict[str, str], list[Row]]:
    """Machine and rows of a file that `write_page` wrote.

    Raises: DataError for anything else; MissingError where there is no such file.
    """
    try:
        held = json.loads(path.read_text())
        return dict(held["machine"]), list(held["rows"])
    except FileNotFoundError:
        raise MissingError(f"{path}: no such file; measure with --page first") from None
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path}: not the rows of a page ({error}); expected machine and rows"
        ) from error


def write_page(study: Study, machine: dict[str, str], rows: list[Row], page: Path) -> None:
    """Write the page, its rows as JSON beside it, and its pictures below images/.

    The page is made of the rows as they are in the file, so it can be made again from it.
    """
    assert study.page is not None
    kept: Any = [{key: _short(value) for key, value in row.items()} for row in rows]
    kept = output.finite(kept)
    folder = page.parent / "images" / page.stem
    drawn = study.pictures(kept, folder) if study.pictures else []
    lines = ",\n".join("  " + json.dumps(row, ensure_ascii=False) for row in kept)
    held = f'{{"machine": {json.dumps(machine, ensure_ascii=False)},\n "rows": [\n{lines}\n]}}\n'
    write_text(page.with_suffix(".json"), held)
    names = [os.path.relpath(path, page.parent) for path in drawn]
    write_text(page, study.page(machine, kept, names))
    output.log(f"written: {page}")


def _short(value: object) -> object:
    """Floats with six significant digits."""
    return float(f"{value:.6g}") if isinstance(value, float) and math.isfinite(value) else value


def _log(name: str, out: Path, machine: dict[str, str], rows: list[Row], files: list[Path]) -> None:
    from splatproof.reports.mlflow_client import default_uri
    from splatproof.reports.study_log import log_study

    reason = log_study(name, machine, rows, files, default_uri(out))
    if reason:
        output.warn(f"{reason}; the rows are on disk")


def _print_table(columns: tuple[str, ...], rows: list[Row]) -> None:
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
