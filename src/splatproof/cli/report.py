"""`bench report`: the leaderboard and the page, from the tracking store alone."""

import datetime
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reports.table import Table

PIPED_WIDTH = 160
"""Characters a line where stdout is no terminal."""


def report(
    *,
    out: Path = Path("runs"),
    uri: str | None = None,
    markdown: Path | None = None,
    html: Path | None = None,
) -> int:
    """Print the leaderboard and write the report page.

    Finished cases below OUT that are not in the tracking store yet are logged first; everything that
    is shown is then read from the store alone. With --json each case is a line instead of the table:
    suite, scene, method, seed, protocol, every metric by its name (psnr, ...), train_seconds,
    render_ms, primitives, bytes_on_disk, peak_memory_mb, settings, error.

    Args:
        out: Folder of runs: what `bench run` or `bench fit` calls OUT, or a folder above several.
        uri: Tracking URI of the store. None: MLFLOW_TRACKING_URI, else OUT/mlflow.db.
        markdown: Also write the leaderboard as Markdown to this file.
        html: File that the page is written to. None: OUT/report.html.
    """
    from splatproof.base.files import write_text
    from splatproof.reports.leaderboard import build_tables
    from splatproof.reports.mlflow_client import check_uri, default_uri, shown_uri
    from splatproof.reports.page import render_page
    from splatproof.reports.store import read_results
    from splatproof.reports.text import markdown as as_markdown
    from splatproof.reports.text import record

    uri = default_uri(out) if uri is None else uri
    check_uri(uri)
    unlogged = sync_cases(out, uri)
    stored = read_results(uri)
    if not stored:
        raise UsageError(
            f"nothing to report: no finished case below {out} and none in {shown_uri(uri)}; "
            "run `bench run quick` first, or name the folder with --out"
        )
    results = [one.result for one in stored]
    tables = build_tables(results)
    page = html or out / "report.html"
    now = datetime.datetime.now(datetime.UTC)
    write_text(page, render_page(tables, stored, uri, now))
    if markdown:
        write_text(markdown, as_markdown(tables))
    if output.wants_json():
        for result in results:
            output.print_record(record(result))
        output.log(f"page: {page}")
    else:
        print_tables(tables)
        output.print_text(f"page: {page.resolve()}")
    return int(unlogged)


def print_tables(tables: "list[Table]") -> None:
    """Print the leaderboard on stdout."""
    from splatproof.reports.text import terminal

    width = None if sys.stdout.isatty() else PIPED_WIDTH
    console = Console(width=width, highlight=False)
    console.print(terminal(tables, console.width))


def sync_cases(out: Path, uri: str) -> bool:
    """Log the cases below `out` that are not in the store yet, and tell which could not be.

    Args:
        out: Folder of the runs.
        uri: Tracking URI of the store.
    Returns: Whether any case could not be logged.
    """
    from splatproof.reports.store import find_cases, sync

    with output.progress() as bar:
        task = bar.add_task("tracking store", total=None, values="")
        failures = sync(
            find_cases(out), uri, lambda done, total: bar.update(task, completed=done, total=total)
        )
    for reason in {failure.reason: None for failure in failures}:
        folders = [str(failure.folder) for failure in failures if failure.reason == reason]
        more = f" and {len(folders) - 1} more" if len(folders) > 1 else ""
        output.warn(f"{folders[0]}{more}: not logged: {reason}")
    return bool(failures)
