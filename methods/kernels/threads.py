"""How many threads the kernels compute in: as many as torch, unless all are lent to them."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from splatproof import _ext

_lent: int | None = None
"""Threads that torch has left to the kernels; None: it has its own."""


def use_threads() -> None:
    """Let the kernels compute in their threads from now on: every call of a kernel begins with it."""
    _ext.set_threads(_lent or torch.get_num_threads())


@contextmanager
def lent() -> Iterator[None]:
    """Let torch compute in one thread inside, and the kernels in as many as torch had.

    Between two kernels a training step calls dozens of torch's operations on tensors so small that to wake a second
    thread takes longer than what it does. On two cores steps of dlg-gs take 0.88 and of pvg 0.80 of the time so.
    """
    global _lent
    if _lent:
        yield
        return
    _lent = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(_lent)
        _lent = None
