"""What every command prints: results on stdout, everything else on stderr."""

import json
import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from splatproof.base.quiet import is_quiet, silenced

WIDE = 160
"""Columns of a table where stdout is no terminal."""
LINE_SECONDS = 10.0
"""Seconds between lines of progress where stderr is no terminal."""


@dataclass(frozen=True, kw_only=True)
class Style:
    """How the running command speaks."""

    json: bool = False
    """Results as one JSON object a line instead of text for people."""
    quiet: bool = False
    """No logs and no progress on stderr; errors are still told."""


_style: ContextVar[Style] = ContextVar("style", default=Style())  # noqa: B039 (it is frozen)


@contextmanager
def speaking(style: Style) -> Iterator[None]:
    """Everything printed inside the block follows `style`."""
    token = _style.set(style)
    try:
        with silenced(style.quiet):
            yield
    finally:
        _style.reset(token)


def wants_json() -> bool:
    """Whether results are to be JSON lines (--json)."""
    return _style.get().json


def print_record(record: Mapping[str, object]) -> None:
    """Print one result for a machine: a JSON object on a line of stdout, nan and inf as null."""
    # what a console cannot show is escaped as JSON has it, not as Python has it
    plain = "utf" not in (sys.stdout.encoding or "").lower()
    print(json.dumps(finite(record), allow_nan=False, ensure_ascii=plain), flush=True)


def print_text(text: str) -> None:
    """Print a result for a person on stdout, as it is (no markup, no wrapping)."""
    print(text, flush=True)


def print_table(table: Table) -> None:
    """Print a table as a result for a person, on stdout.

    Args:
        table: As wide as the terminal; in a file or pipe, `WIDE` columns.
    """
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDE
    console.print(table)


def emit(record: Mapping[str, object], text: str) -> None:
    """Print one result on stdout.

    Args:
        record: What --json prints, as a JSON object on a line.
        text: What a person reads without --json.
    """
    if wants_json():
        print_record(record)
    else:
        print_text(text)


def console() -> Console:
    """The console for logs and progress: stderr, silent with --quiet."""
    return Console(stderr=True, quiet=is_quiet(), highlight=False)


def log(text: str) -> None:
    """Tell a person what is going on: one line on stderr, nothing with --quiet."""
    console().print(text, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Tell a person what went wrong but does not stop the command; --quiet does not hide it."""
    print(f"bench: {text}", file=sys.stderr)


class _Lines(Progress):
    """A bar where there is a terminal; elsewhere a line now and then, which a log can hold."""

    def __init__(
        self, *columns: ProgressColumn, console: Console, silent: bool, **named: Any
    ) -> None:
        """Start without tasks.

        Args:
            columns: What a bar shows.
            console: Where it goes.
            silent: Whether neither bar nor line is shown.
            named: What else rich's Progress takes.
        """
        super().__init__(
            *columns, console=console, disable=silent or not console.is_terminal, **named
        )
        self._lines = not silent and not console.is_terminal
        self._told = time.monotonic()

    def update(self, task_id: TaskID, **values: Any) -> None:
        """Take new values of a task, and tell them where the last line is LINE_SECONDS old.

        Args:
            task_id: Which task.
            values: As rich's Progress takes them.
        """
        super().update(task_id, **values)
        if self._lines and time.monotonic() - self._told >= LINE_SECONDS:
            self._told = time.monotonic()
            self._tell(next(task for task in self.tasks if task.id == task_id))

    def _tell(self, task: Task) -> None:
        left = task.time_remaining
        parts = [
            task.description,
            f"{task.completed:g}" + (f"/{task.total:g}" if task.total else ""),
            str(task.fields.get("values", "")),
            f"{timedelta(seconds=round(left))} left" if left else "",
        ]
        log("  ".join(part for part in parts if part))


def progress() -> Progress:
    """A progress bar on stderr with time left and `values` (a text field of each task).

    Where stderr is no terminal, a line every LINE_SECONDS in its place.
    """
    return _Lines(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[values]}"),
        console=console(),
        transient=True,
        redirect_stdout=False,  # results must reach a pipe also while a bar is on the terminal
        silent=is_quiet(),
    )


def finite(value: object) -> object:
    """`value` with non-finite floats as None, since JSON has no such numbers."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
