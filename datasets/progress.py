"""A progress bar on stderr for long work in this room."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from splatproof.base.quiet import is_quiet


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Shows (done, total) while the block runs; one plain line where stderr is no terminal.

    Nothing is shown where logs and progress are silenced.
    """
    console = Console(stderr=True, quiet=is_quiet(), highlight=False)
    if not console.is_terminal:
        console.print(title, markup=False, soft_wrap=True)
        yield lambda done, total: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn(),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=console.quiet) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
