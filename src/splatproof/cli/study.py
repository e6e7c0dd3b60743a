"""`bench study NAME`: a question answered by measured rows instead of trained cases."""

import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import tyro

from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.files import read_json, read_text, write_text
from splatproof.cli import output
from splatproof.cli.binding import bound
from splatproof.methods.contracts.backends import get_backend
from splatproof.suites.studies.study import STUDIES, Study

Row = dict[str, Any]


def subcommands() -> dict[str, Callable[..., int]]:
    """One command a study, so that each shows the options that it obeys and no others."""
    return {name: _command(name, study) for name, study in STUDIES.items()}


def run_study(
    name: str,
    *,
    out: Path = Path("runs"),
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    wait: float = 300.0,
    backend: str = "cpu",
    only: str | None = None,
    page: Path | None = None,
    rows: Path | None = None,
    runs: Path | None = None,
    roma: Path | None = None,
) -> int:
    """Print a table of the study's rows and keep them in OUT/STUDY.jsonl, a JSON object a line.

    Rows are kept as they come. The speed study goes on after the last whole case where it was stopped, if
    machine, code and options are the same; others start over. Pictures, where the study draws any, go to OUT/STUDY/. With --json each row is a line on stdout as soon as it is measured. The
    exit code is 1 if a row is over its error budget.

    Args:
        name: Name of the study.
        out: Folder for the rows and pictures.
        quick: Measure the reduced form: fewer and smaller cases.
        wait: Seconds that the whole study may lose while it waits for other processes to leave the
            machine idle; after that rows have no times, but ratios of implementations that took turns.
            With --quick it never waits.
        backend: Name of the rasterizer whose implementations are measured beside those of the CPU.
        only: Measure only the cases that match this pattern on component/case, e.g. "rasterizer/*" or
            "adam"; "roofline" is the engine's stages.
        page: Also write the study's Markdown page to this file, its rows as JSON beside it and its
            pictures to images/ beside it.
        rows: Measure nothing: write the page again from the rows in this JSON file, which an earlier
            --page has written. Needs --page.
        runs: Folder of kept runs whose renders are looked at.
        roma: Folder of RoMa's weights, as setting dense.weights takes it: a row more, of its matches.

    Returns: 1 if a row says that it failed, else 0.
    Raises: UsageError for options that do not go together; DataError if the file that rows are read
        from is none.
    """
    study = STUDIES[name]
    if not 0 <= wait < math.inf:
        raise UsageError(f"--wait is {wait}, expected seconds, 0 or more")
    if only is not None and page is not None:
        raise UsageError("--page shows every case: give it without --only")
    if rows is not None:
        if page is None or quick:
            raise UsageError("--rows makes a page again from its rows: give --page, not --quick")
        write_page(study, *read_rows(rows), page)
        return 0
    machine = _machine(study, backend)
    file = out / f"{name}.jsonl"
    found = _measure(
        name,
        study,
        quick,
        {"wait": wait, "backend": backend, "only": only, "runs": runs, "roma": roma},
        file,
        machine,
    )
    if not output.wants_json():
        _print_table(study.columns, found)
    failed = [row for row in found if row.get("ok") is False]
    for row in failed:
        output.warn(f"{name}: {row} is over its budget")
    output.log(f"{len(found)} rows, {len(failed)} over their budget; kept in {file}")
    drawn = study.pictures(found, out / name) if study.pictures else []
    for path in drawn:
        output.log(f"drawn: {path}")
    if page is not None:
        write_page(study, machine, found, page)
    if study.logged:
        _log(name, out, machine, found, [file, *drawn])
    return int(bool(failed))


def _command(name: str, study: Study) -> Callable[..., int]:
    """The command of one study, without the options that it takes no notice of."""
    obeyed = {"out", "quick", *study.options, *(("page", "rows") if study.page else ())}
    without = {"wait", "backend", "only", "page", "rows", "runs", "roma"} - obeyed
    title = f"{study.description[0].upper()}{study.description[1:]}."
    return bound(run_study, {"name": name}, without=without, title=title)


def _measure(
    name: str, study: Study, quick: bool, given: Row, file: Path, machine: Mapping[str, str]
) -> list[Row]:
    """All rows, told and kept in the file as they come: a kill loses only what is being measured."""
    options = {option: given[option] for option in study.options}
    if "backend" in study.options:
        get_backend(given["backend"])
    begun, known = file.with_suffix(".begun.json"), {}
    if study.resumes:
        of = {"quick": quick, "machine": dict(machine)}
        of |= {key: value for key, value in options.items() if key != "wait"}  # changes no case
        known = {"kept": kept_rows(begun, file, of)}
        write_text(begun, json.dumps(of))
        if known["kept"]:
            output.log(f"{len(known['kept'])} rows of a study that was stopped are kept")
    rows: list[Row] = []
    lines: list[str] = []
    if not known.get("kept"):  # else a kill before the first row would lose them
        write_text(file, "")
    try:
        with output.progress() as bar:
            task = bar.add_task(name, total=None, values="")
            for row in study.rows(quick=quick, **options, **known):
                rows.append(row)
                lines.append(json.dumps(output.finite(row), ensure_ascii=False) + "\n")
                write_text(file, "".join(lines))
                bar.update(task, completed=len(rows), values=str(row.get("case", "")))
                if output.wants_json():
                    output.print_record(row)
    except KeyboardInterrupt:
        goes = "goes on" if study.resumes else "starts over"
        output.warn(f"interrupted: {len(rows)} rows are kept in {file}; the same command {goes}")
        raise SystemExit(130) from None
    begun.unlink(missing_ok=True)
    return rows


def kept_rows(begun: Path, file: Path, of: Row) -> list[Row]:
    """Rows of an earlier call of the same words that did not come to its end.

    Args:
        begun: File that says what is being measured; it is removed at the end.
        file: Rows so far, a JSON object a line.
        of: What is to be measured now.

    Returns: Those of whole cases: the last case that is there may be short of some.
    """
    if not (begun.is_file() and file.is_file()):
        return []
    try:
        if read_json(begun) != json.loads(json.dumps(of)):
            return []
        rows = [json.loads(line) for line in read_text(file).splitlines()]
        cases = [(row["component"], row["case"]) for row in rows]
    except (DataError, ValueError, KeyError, TypeError):  # others wrote into them: start over
        return []
    return [row for row, case in zip(rows, cases, strict=True) if case != cases[-1]]


def _machine(study: Study, backend: str) -> dict[str, str]:
    """Where the rows are measured, for studies that say it."""
    if study.page is None and not study.logged:
        return {}
    from splatproof.suites.environment import machine

    return machine(backend)


def read_rows(path: Path) -> tuple[dict[str, str], list[Row]]:
    """Read the machine and the rows that `write_page` wrote.

    Args:
        path: JSON file beside a page.
    Returns: Facts of the machine by name, and the rows.
    Raises: DataError for anything else; MissingError where there is no such file.
    """
    if not path.exists():
        raise MissingError(f"{path}: no such file; measure with --page first")
    held = read_json(path)
    try:
        return dict(held["machine"]), list(held["rows"])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path}: not the rows of a page ({error}); expected machine and rows"
        ) from error


def write_page(study: Study, machine: dict[str, str], rows: list[Row], page: Path) -> None:
    """Write the page, its rows as JSON beside it, and its pictures below images/.

    The page is made of the rows as they are in the file, so it can be made again from it.

    Args:
        study: One that has a page.
        machine: Facts of the machine that the rows were measured on, by name.
        rows: What was measured.
        page: Markdown file to write.
    """
    assert study.page is not None
    short = [{key: _short(value) for key, value in row.items()} for row in rows]
    kept = cast(list[Row], output.finite(short))
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
