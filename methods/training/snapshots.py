"""The model of a running training, written now and then for another process that shows it."""

import io
import pickle
import time
import types
from pathlib import Path
from typing import Any

from splatproof.base.files import write_bytes
from splatproof.methods.contracts.model import Model

SNAPSHOT = "snapshot.pickle"
"""Name of the file in the folder of snapshots; the newest replaces the one before."""
EVERY_SECONDS, SHARE = 3.0, 0.01
"""Least seconds between two snapshots, and most of the time of a training that they may take."""


class Snapshots:
    """Called while a model trains: writes it, at most as often as costs a hundredth of the time."""

    def __init__(self, folder: Path) -> None:
        """Write the first snapshot at the first call.

        Args:
            folder: Where the file lies; nobody else may write there, since reading it runs code.
        """
        self._path = folder / SNAPSHOT
        self._next = 0.0

    def __call__(self, step: int, total: int, model: Model) -> None:
        """Write the model as it is now, if it is time to.

        Args:
            step: Training steps that are done.
            total: Training steps of the whole run.
            model: What is written; only read here.
        """
        started = time.monotonic()
        if started < self._next and step < total:
            return
        write_bytes(self._path, pickled((step, total, model)))
        ended = time.monotonic()
        self._next = ended + max(EVERY_SECONDS, (ended - started) / SHARE)


def read_snapshot(folder: Path) -> tuple[int, int, Model]:
    """Step, steps of the whole run, and the model; it can be drawn and not be trained.

    Args:
        folder: As for `Snapshots`, in a folder of this program's own.
    Raises: FileNotFoundError where no snapshot has been written yet.
    """
    return pickle.loads((folder / SNAPSHOT).read_bytes())


def pickled(value: object) -> bytes:
    """A value whose closures are left out: rates and schedules, which training alone calls.

    Args:
        value: Anything else that pickle can write.
    """
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(value)
    return file.getvalue()


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, types.FunctionType) and "<locals>" in obj.__qualname__:
            return _left_out, (obj.__qualname__,)
        return NotImplemented


def _left_out(name: str) -> None:
    """What stands in a snapshot for a closure."""
    del name
