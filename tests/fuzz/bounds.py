"""One input under its bounds: seconds, memory, and what a reader may answer."""

import dataclasses
import gc
import math
import resource
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np

from fuzz.target import Target
from splatproof.base.errors import SplatproofError
from splatproof.base.memory import MEBIBYTE, peak_memory_mb

SECONDS = 1.0
"""Processor time that reading one input may take."""
BYTES_EACH = 64
"""Memory per byte of the file ..."""
BYTES_ALWAYS = 256 * MEBIBYTE
"""... and beside that."""
ADDRESSES = 2**31
"""Addresses that a reader may ask for beside those that are taken: a bomb ends here, not the machine."""
WORDS = 4_000
"""Characters of the longest error that is one line for a reader."""


class Overdue(BaseException):
    """The bound on time is passed; no `except Exception` swallows it."""


@dataclasses.dataclass(frozen=True)
class Answer:
    """What became of an input."""

    accepted: bool
    fault: str = ""
    """What is wrong with the reader; empty: nothing."""


def _overdue(number: int, frame: FrameType | None) -> None:
    raise Overdue


def forget_peak() -> None:
    """Let the peak start again at what is held now (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")


def confine() -> None:
    """Bound this process: a reader that asks for too much gets MemoryError instead of the machine."""
    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGPROF, _overdue)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    forget_peak()


@contextmanager
def _clock() -> Iterator[None]:
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def put(target: Target, data: bytes) -> None:
    """Write an input where its reader will look.

    Args:
        target: Whose reader it is.
        data: The input.
    """
    target.path.write_bytes(data)
    if target.prepare is not None:
        target.prepare(target.path)


def tried(target: Target, data: bytes, held: float) -> Answer:
    """Write an input, read it, and judge: an error of the project's in one line, or sound values.

    Args:
        target: Whose reader it is.
        data: The input.
        held: Resident bytes before, from which growth is counted.
    """
    put(target, data)
    if peak_memory_mb() * MEBIBYTE - held > BYTES_ALWAYS / 2:
        forget_peak()  # of making the input, or of one before
    begun, accepted, fault = time.process_time(), False, ""
    try:
        with _clock():
            value = target.read(target.path)
        accepted = True
        if target.finite and (place := not_finite(value)):
            fault = f"accepted with a number that is not finite: {place}"
    except SplatproofError as error:
        fault = _words(target, str(error))
    except Overdue:
        fault = f"took more than {SECONDS:g} s"
    except BaseException as error:  # noqa: BLE001 (whatever else a reader raises is the finding)
        fault = f"{type(error).__name__}: {str(error)[:200]}"
    seconds = time.process_time() - begun
    if seconds > SECONDS:  # native code hears no signal
        fault = fault or f"took more than {SECONDS:g} s: {seconds:.1f}"
    grown = peak_memory_mb() * MEBIBYTE - held
    if grown > BYTES_ALWAYS + BYTES_EACH * len(data) + target.room(data):
        forget_peak()
        fault = fault or f"took {grown / MEBIBYTE:.0f} MiB for {len(data)} bytes"
    return Answer(accepted, fault)


def _words(target: Target, text: str) -> str:
    """What is wrong with an error's words."""
    if not text.strip() or "\n" in text or "\r" in text:
        return f"an error that is not one line: {text[:200]!r}"
    if len(text) > WORDS:
        return f"an error of {len(text)} characters: {text[:100]!r}"
    if str(target.path if target.named else target.path.parent) not in text:
        return f"an error that does not name the file: {text[:200]!r}"
    return ""


def not_finite(value: object, place: str = "value") -> str:
    """Where in arrays, numbers and their containers NaN or an infinity is; empty: nowhere.

    Args:
        value: What a reader gave.
        place: How it is called.
    """
    if isinstance(value, float):
        return "" if math.isfinite(value) else f"{place} is {value}"
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        return "" if array.dtype.kind != "f" or bool(np.isfinite(array).all()) else place
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    items = value.items() if isinstance(value, Mapping) else ()
    items = enumerate(value) if isinstance(value, list | tuple) else items
    return next((found for key, one in items if (found := not_finite(one, f"{place}.{key}"))), "")
