"""Whether this process, and those that work for it, keep logs and progress to themselves."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


def is_quiet() -> bool:
    """Whether nothing but errors and warnings is to be shown on stderr."""
    return _quiet.get()


@contextmanager
def silenced(quiet: bool) -> Iterator[None]:
    """Inside the block, in this thread and in workers that it starts, `quiet` holds.

    Args:
        quiet: True: no logs and no progress; False: both are shown.
    """
    token = _quiet.set(quiet)
    try:
        yield
    finally:
        _quiet.reset(token)
