"""What every command prints: results on stdout, everything else on stderr."""

import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from splatproof.base.quiet import is_quiet, silenced


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
    print(json.dumps(finite(record), allow_nan=False, ensure_ascii=False), flush=True)


def print_text(text: str) -> None:
    """Print a result for a person on stdout, as it is (no markup, no wrapping)."""
    print(text, flush=True)


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


def progress() -> Progress:
    """A progress bar on stderr with time left and `values` (a text field of each task)."""
    screen = console()
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[values]}"),
        console=screen,
        transient=True,
        redirect_stdout=False,  # results must reach a pipe also while a bar is on the terminal
        disable=is_quiet() or not screen.is_terminal,
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
